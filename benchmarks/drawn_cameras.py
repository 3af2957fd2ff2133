"""Whole cameras drawn at random from what stages and camera quantities declare, for ``random_cameras.py``.

In:  a seed, a folder for the tables and pictures that a camera may name.
Out: a pipeline document (``random_cameras.toml_of`` writes it); a stage's ``name`` is its slot in the chain.

A declared range is drawn from as it stands, log-uniformly where it spans decades; one without an end is cut to a span
that is wide for a camera (``SPANS``, ``WIDE``). Knobs of fidelity keep their defaults: what they cost in accuracy is
another question. What stages say together about several values (bins that divide, light as wide as the pixels, a mask's
own demosaicers) is kept, so that few cameras are refused. Methods of ``white_estimate`` that look at the picture are
not drawn: they refuse pictures by their contract.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from etendue.contract.capabilities import is_source
from etendue.contract.registry import installed_stages
from etendue.contract.stage import Stage, parameters_of, reads_of
from etendue.contract.values import quantities as camera
from etendue.contract.values.parameter import MISSING, Parameter
from etendue_camera.sensor import cfa
from etendue_camera.spectra.names import rgb_space_names, tables

Document = dict[str, Any]
LARGEST, SMALL = 48, 16  # pixels along a side
INF = math.inf
SPANS: dict[str, tuple[float, float]] = {
    "f_number": (0.5, 128),
    "focal_length": (0.5, 2000),
    "magnification": (-2, -1e-4),
    "pupil_magnification": (0.2, 5),
    "focus_distance": (10, 1e7),
    "object_distance": (10, 1e7),
    "transmittance": (0.01, 1),
    "pixel_pitch": (0.3, 50),
    "aperture_fraction": (0.05, 1),
    "integration_time": (1e-6, 1e3),
    "peak_qe": (0.01, 1),
    "depletion_depth": (0.05, 20),
    "diffusion_depth": (0.1, 1000),
    "diffusion_length": (0.1, 1e4),
    "surface_transmission": (0.01, 1),
    "full_well_density": (1, 1e6),
    "dark_current_density": (1e-14, 1e-4),
    "dark_doubling": (1, 50),
    "analogue_gain": (1e-2, 1e4),
    "read_noise_after": (0.1, 1000),
    "read_noise": (0.01, 1000),
    "dsnu": (0.01, 100),
    "conversion_gain": (1e-4, 1e3),
    "render_exposure": (1e-3, 1e3),
    "white_luminance": (1e-3, 1e6),
}
WIDE = {
    "um": (0.01, 2.0),
    "mm": (0.01, 10.0),
    "deg": (0.0, 180.0),
    "electron": (0.1, 100.0),
    "deg/mm": (0.01, 5.0),
    "1": (1e-3, 0.1),
}
WINDOWS = ((380, 780), (400, 700), (360, 830), (300, 1100))
BINS = (1, 2, 5, 7, 10, 13, 20, 25, 40, 50, 100, 150, 300, 400)  # nm
OWN_MASKS = ("RG/GB", "RGB/", "GR/BG", "RYYB/YRBY", "RGBE/GRBE", "R/G/B", "CM/YG", "RGW/GBW/WWR", "B/", "RW/WB")
FIXED = {  # the drawer's own affair, or given in another way
    "width",
    "height",
    "spacing",
    "light",
    "wavelength_from",
    "wavelength_to",
    "bin_width",
    "rows",
    "columns",
    "sampling",
    "radiance",
}
SPACES = {"display", "matrix", "target"}


class Drawn:
    """One camera while it is drawn."""

    def __init__(self, seed: int, folder: Path, small: bool = False) -> None:
        self.seed, self.folder, self.small = seed, folder, small
        self.rng = np.random.default_rng([20260101, seed])
        self.registry = installed_stages()
        self.stages: list[Document] = []
        self.camera: Document = {}

    @contextmanager
    def stream(self, *words: str) -> Iterator[None]:
        """Draws of their own, so that a parameter that is new elsewhere changes nothing here."""
        kept, self.rng = self.rng, np.random.default_rng([20260101, self.seed, zlib.crc32(" ".join(words).encode())])
        try:
            yield
        finally:
            self.rng = kept

    # -- values

    def chance(self, share: float) -> bool:
        return bool(self.rng.random() < share)

    def one_of(self, values: Any) -> Any:
        values = list(values)
        return values[int(self.rng.integers(len(values)))]

    def between(self, low: float, high: float) -> float:
        """Uniform, or log-uniform over decades; rounded to six digits, inside."""
        if low > 0 and high > 20 * low:
            value = math.exp(self.rng.uniform(math.log(low), math.log(high)))
        elif high < 0 and low < 20 * high:
            value = -math.exp(self.rng.uniform(math.log(-high), math.log(-low)))
        else:
            value = self.rng.uniform(low, high)
        return min(max(float(f"{value:.6g}"), low), high)

    def value(self, name: str, parameter: Parameter, kind: Any, default: Any) -> Any:
        """A value in the declared range; the default where nothing is known to draw."""
        if parameter.choices:
            return self.one_of(parameter.choices)
        if name in SPACES and kind is str:
            return self.one_of((*rgb_space_names(), *tables("display")))
        if kind is bool:
            return self.chance(0.5)
        if kind not in (int, float) or parameter.fidelity:
            return default
        if parameter.infinite and self.chance(0.2):
            return INF
        if default == 0 and parameter.at_least == 0 and self.chance(0.3):
            return default
        found = self.between(*self.span(name, parameter, default))
        signed = default == 0 and parameter.at_least is None and parameter.above is None
        found = -found if signed and self.chance(0.5) else found
        found = round(found) if kind is int else found
        return found if parameter.allows(found) else default

    def span(self, name: str, parameter: Parameter, default: Any) -> tuple[float, float]:
        """The declared range; where it has no end, one that is wide for a camera."""
        limits = [parameter.at_least if parameter.at_least is not None else parameter.above]
        limits.append(parameter.at_most if parameter.at_most is not None else parameter.below)
        if name in SPANS:
            wide = SPANS[name]
        elif default is not MISSING and default and math.isfinite(default):
            wide = (abs(default) / 100, abs(default) * 100)
        else:
            wide = WIDE.get(parameter.units, (0.01, 100.0))
        low = wide[0] if limits[0] is None else max(wide[0], limits[0])
        high = wide[1] if limits[1] is None else min(wide[1], limits[1])
        return (low, high) if low <= high else (float(limits[0] or 0), float(limits[1] or 1))

    # -- stages

    def add(self, slot: str, use: str, share: float = 0.25, **given: Any) -> Document:
        """A stage with values of its own, each drawn with some chance."""
        stage: Document = {"use": use, "name": slot}
        for name, (parameter, kind, default) in parameters_of(self.registry.load(use)).items():
            if name in given or parameter.shared or name in FIXED:
                continue
            with self.stream(slot, name):
                drawn = default is MISSING or self.chance(share)
                found = self.value(name, parameter, kind, default) if drawn else default
            if found is not MISSING and found != default:
                stage[name] = found
        stage |= {name: value for name, value in given.items() if value is not None}
        self.stages.append(stage)
        return stage

    def maybe(self, chance: float, slot: str, use: str, **given: Any) -> None:
        if self.chance(chance):
            self.add(slot, use, **given)

    def able(self, fits: Callable[[type[Stage]], bool]) -> list[str]:
        return [name for name in self.registry.names() if fits(self.registry.load(name))]

    def file(self, what: str) -> Path:
        return self.folder / f"{self.seed}-{what}"

    # -- the camera

    def document(self) -> Document:
        self.quantities()
        self.light()
        self.sensor()
        self.picture()
        found: Document = {
            "name": f"camera{self.seed}",
            "seed": self.seed,
            "camera": self.camera,
            "stages": self.stages,
        }
        if self.chance(0.2):
            found["precision"] = self.one_of(("float32", "float64"))
        if self.chance(0.2):
            found["tolerance"] = self.one_of((0.0, 1e-6, 1e-2))
        return found

    def quantities(self) -> None:
        """Camera quantities, each drawn with some chance; those that belong together, together."""
        own = {}
        always = ("f_number", "pixel_pitch", "integration_time")
        for name in camera.names():
            parameter = camera.declared(name)
            default = parameter.default
            if default is MISSING or (isinstance(default, str) and not parameter.choices):
                continue
            with self.stream("camera", name):
                if name in always or self.chance(0.3):
                    own[name] = self.value(name, parameter, type(default), default)
        room = 0.5 * (1 - own.get("aperture_fraction", 0.741))
        for name in ("aperture_offset_y", "aperture_offset_x"):
            if name in own:
                own[name] = self.between(-room, room)
        fill = own.get("aperture_fraction", 0.741) ** 2
        own["microlens_gain"] = self.between(1, 0.999 / fill) if self.chance(0.3) else 1.0
        for name in ("iso", "base_iso", "t_number", "object_distance", "focus_distance", "magnification"):
            own.pop(name, None)
        if self.chance(0.15):
            own["t_number"] = float(f"{own['f_number'] * self.between(1, 2):.6g}")
            own.pop("transmittance", None)
        if self.chance(0.15):
            own["base_iso"] = self.between(10, 1000)
            own["iso"] = float(f"{own['base_iso'] * self.between(0.5, 100):.6g}")
            own.pop("analogue_gain", None)
        if self.chance(0.1):
            own["magnification"] = self.between(*SPANS["magnification"])
        elif self.chance(0.1):
            own["focus_distance"] = float(f"{own.get('focal_length', 6.93) * self.between(1.5, 1e4):.6g}")
        own["bits"] = own.get("bits", 12)
        own["black_level"] = self.one_of((0, 1, round(2 ** own["bits"] / 64), round(2 ** own["bits"] / 4)))
        if own["black_level"] >= 2 ** own["bits"] - 1:
            own["black_level"] = 0
        own["sensor_serial"] = str(self.rng.integers(100))
        own["pattern"] = self.one_of((*cfa.NAMES, *cfa.BAYER, *cfa.BAYER, *OWN_MASKS))
        self.letters = cfa.parse(own["pattern"]).channels
        count = len(self.letters) if self.chance(0.7) else 1
        own["peak_qe"] = [self.between(*SPANS["peak_qe"]) for _ in range(count)]
        self.camera = own

    def window(self) -> tuple[float, float, float]:
        """Wavelengths from, to, and the width of a bin, nm: mostly as many bins as channels, which fewer do not tell
        apart.
        """
        least = 1 if self.chance(0.05) else len(self.letters)
        if self.chance(0.75):
            low, high = self.one_of(WINDOWS[:2] if self.chance(0.8) else WINDOWS)
            fits = [b for b in BINS if (high - low) % b == 0 and least <= (high - low) / b <= 80]
            return float(low), float(high), float(self.one_of(fits))
        low, width = int(self.rng.integers(360, 700)), self.one_of(BINS[:-4])
        count = max(least, min(int(self.rng.integers(1, 25)), (830 - low) // width))
        return float(low), float(low + count * width), float(width)

    def illuminant(self, low: float, high: float) -> str:
        covering = [name for name, (first, last) in tables("illuminant").items() if first <= low and high <= last]
        kind = self.rng.random()
        if kind < 0.03:
            return f"{self.rng.integers(math.ceil(low), math.floor(high) + 1)} nm"
        if kind < 0.3 or not covering:
            return f"{round(self.between(500, 50000))} K"
        return "E" if kind < 0.4 else str(self.one_of(covering))

    def filters(self, low: float, high: float) -> None:
        """Whose filters the sensor has: a camera of the library, none, or a table, which may end inside the light."""
        kind = self.rng.random()
        rgb = set(self.letters) <= set("RGB")
        self.camera["sensitivity_per"] = self.one_of(("photon", "energy"))
        if kind < 0.35 and rgb and high <= 780 and low >= 380:
            self.camera["sensitivity"] = self.one_of(tables("camera"))
        elif kind < 0.5:
            self.camera["sensitivity"] = "flat"
        else:
            short = 0.2 * (high - low) if self.chance(0.2) else -40.0
            nodes = np.linspace(max(low + short, 1.0), high - short, 33)
            rows = [f"wavelength_nm,{','.join(self.letters)}"]
            centres = {"R": 0.8, "G": 0.5, "B": 0.2}
            for node in nodes:
                share = (node - low) / max(high - low, 1.0)
                curves = [0.02 + math.exp(-(((share - centres.get(c, 0.5)) / 0.25) ** 2)) for c in self.letters]
                rows.append(",".join(f"{v:.6g}" for v in (node, *curves)))
            self.file("filters.csv").write_text("\n".join(rows) + "\n")
            self.camera["sensitivity"] = self.file("filters.csv").name
        self.camera["sensitivity_kind"] = self.one_of(("system_qe", "filter_transmittance"))

    def light(self) -> None:
        """The scene, and what stands between it and the pixels."""
        low, high, width = self.window()
        self.camera["illuminant"] = self.illuminant(low, high)
        self.filters(low, high)
        pitch = self.camera["pixel_pitch"]
        self.rows, self.columns = (
            int(self.one_of((1, 2, 3, *range(4, SMALL if self.small else LARGEST + 1)))) for _ in range(2)
        )
        self.paper = self.chance(0.1)
        spacing = pitch if self.paper else float(f"{pitch / self.one_of((1, 2, 2, 3, 4, self.between(1, 4))):.9g}")
        margin = 0 if self.paper else int(self.rng.integers(0, 9))
        across, down = (math.ceil(n * pitch / spacing - 1e-9) + 2 * margin for n in (self.columns, self.rows))
        frame = max(across, down) * spacing
        centre = [self.between(-2, 2) if self.chance(0.2) else None for _ in range(2)]
        reach = math.hypot(
            *(abs(c or 0.0) + 0.5e-3 * n * spacing for c, n in zip(centre, (down, across), strict=True))
        )  # mm from the axis
        self.cells = self.chance(0.3)
        chosen = self.one_of(
            self.able(
                lambda kind: (
                    is_source(kind)
                    and "white_luminance" in parameters_of(kind)
                    and "variable" not in parameters_of(kind)
                )
            )
        )
        own = (
            {name for name, (p, _, _) in parameters_of(self.registry.load(chosen)).items() if p.units == "um"}
            - FIXED
            - {"margin"}
        )
        scaled = {name: self.between(0.02 * frame, frame) for name in own}
        if {"smallest", "largest"} <= own:
            scaled["smallest"], scaled["largest"] = sorted((scaled["smallest"], scaled["largest"]))
        if "spot_sigma" in own:
            scaled["spot_sigma"], scaled["pitch"] = spacing, spacing * self.between(10, 50)
        if "file" in parameters_of(self.registry.load(chosen)):
            scaled["file"] = self.photograph()
        frequencies = {
            n for n, (p, _, _) in parameters_of(self.registry.load(chosen)).items() if p.units == "cycles/um"
        }
        self.add(
            "scene",
            chosen,
            0.15,
            white_luminance=self.between(*SPANS["white_luminance"]),
            width=across * spacing,
            height=down * spacing,
            spacing=spacing,
            light="cells" if self.cells else "bandlimited",
            wavelength_from=low,
            wavelength_to=high,
            bin_width=width,
            centre_y=centre[0],
            centre_x=centre[1],
            **scaled,
            **{n: self.between(0.05 / spacing, 0.4 / spacing) for n in frequencies},
        )
        scene = self.stages[-1]
        defaults = {name: default for name, (_, _, default) in parameters_of(self.registry.load(chosen)).items()}
        if {"low", "high"} <= set(defaults) and scene.get("low", defaults["low"]) > scene.get("high", defaults["high"]):
            scene.pop("low", None)
            scene.pop("high", None)
        self.add("irradiance", "irradiance")
        self.maybe(0.4, "falloff", "falloff", table=None, model=self.one_of(("cos4", "disc")))
        self.maybe(0.2, "filter", "optical_filter", table=self.transmission(low, high) if self.chance(0.4) else None)
        self.maybe(0.1, "vignetting", "vignetting", **self.rim())
        self.maybe(0.1, "angular", "angular_response", table=None)
        self.maybe(
            0.15,
            "distortion",
            "distortion",
            table=None,
            k1=self.between(-0.02, 0.02),
            k2=None,
            k3=None,
            reference_radius=reach,
        )
        self.lens(spacing)
        self.maybe(0.15, "glare", "glare")
        self.maybe(0.2, "low_pass", "birefringent", dispersion=None)

    def rim(self) -> Document:
        """A rim that lets the beam of an axial point through."""
        beam = 0.5 * self.camera.get("focal_length", 6.93) / self.camera["f_number"]
        distance = self.between(0.1, 10)
        return {"rim_radius": float(f"{beam * self.between(1.2, 20) + distance:.6g}"), "rim_distance": distance}

    def lens(self, spacing: float) -> None:
        lenses = self.able(lambda kind: kind.role == "lens" and "prescription" not in parameters_of(kind))
        use = (
            "diffraction"
            if self.chance(0.5)
            else self.one_of(("diffraction", "lens_gaussian") if self.small else lenses)
        )
        given: Document = (
            {"light": "cells" if self.cells else "bandlimited"}
            if "light" in parameters_of(self.registry.load(use))
            else {}
        )
        if use == "lens_psf":
            radius = np.linspace(0, 8 * spacing, 41)
            rows = [f"{r:.6g},{math.exp(-((r / (1.5 * spacing)) ** 2)):.6g}" for r in radius]
            self.file("psf.csv").write_text("radius_um,psf\n" + "\n".join(rows) + "\n")
            given["file"] = self.file("psf.csv").name
        elif use == "lens_psf_field":
            given["file"] = self.bank(spacing)
        elif use == "wavefront" and self.chance(0.7):
            given["aperture"], given["obstruction"] = "circular", None
        elif use == "wavefront":
            given["aperture"], given["obstruction"] = "annular", self.between(0.1, 0.6)
        elif use == "lens_gaussian":
            given["sigma"] = spacing * self.between(0.1, 4)
        self.add("lens", use, **given)

    def sensor(self) -> None:
        through = self.chance(0.25)
        self.camera["crosstalk"] = "through_filter" if through else "per_plane"
        self.maybe(0.0 if through else 0.6, "diffusion", "diffusion")
        sizes = {} if self.paper else {"rows": self.rows, "columns": self.columns}
        self.add("pixel", "pixel", 0.0, sampling="paper" if self.paper else "physical", **sizes)
        self.add("cfa", "mosaic")
        self.maybe(float(through), "crosstalk", "crosstalk")
        faulty = self.chance(0.15)
        if faulty:
            self.add("defects", "defects", file=None)
        metered = self.chance(0.15)
        if metered:
            self.camera.pop("integration_time", None)
        self.maybe(float(metered), "meter", "meter")
        if self.chance(0.7):
            self.read_out()
        else:  # expected values: without noise and rounding
            self.add("ideal", "ideal_mosaic")
        if faulty and self.chance(0.7):
            self.add("correct", self.one_of(("correct_defects", "correct_found_defects")))
        self.maybe(
            0.1, "shading", "lens_shading", map="model", table=None, model=self.one_of(("cos4", "disc")), **self.rim()
        )

    def read_out(self) -> None:
        self.add("expose", "exposure")
        self.add("shot", "shot_noise")
        self.maybe(0.9, "well", "full_well")
        self.maybe(0.9, "read", "read_noise")
        self.maybe(0.15, "lines", "line_pattern", share=0.7)
        self.add("convert", "adc")
        self.maybe(0.1, "stuck", "stuck_pixels", file=None)
        self.add("linear", "linearise")

    def picture(self) -> None:
        self.add("white", "white")
        if self.chance(0.1):
            gains = [self.between(0.2, 5) for _ in self.letters]
            self.add("estimate", "white_estimate", 0.0, method="preset", gains=gains)
        self.maybe(0.7, "balanced", "balance_mosaic")
        self.add("demosaic", self.one_of(self.demosaicers()))
        channels = 3 if "R" in self.letters and self.stages[-1]["use"] != "demosaic_any" else len(self.letters)
        if self.chance(0.5):
            fits = self.able(
                lambda kind: kind.role in ("sharpening", "denoising") and set(reads_of(kind)) == {"rgb_camera"}
            )
            deep = self.able(
                lambda kind: kind.role == "sharpening" and "transfers" in kind.reads and "rgb_camera" in kind.reads
            )
            self.add(
                "restore", self.one_of(deep if self.chance(0.2) and deep and channels == len(self.letters) else fits)
            )
        self.add("fit", "colour_fit", reflectances=None)
        self.add("to_xyz_scene", "camera_to_xyz")
        display = self.one_of((*rgb_space_names(), *tables("display"))) if self.chance(0.5) else "sRGB"
        self.add(
            "adapt",
            "balance",
            target=display if self.chance(0.8) else self.one_of(("D65", "D50", "A", "E")),
            gains="white",
        )
        self.add("display", "display", display=display)
        self.add("encode", "encode")
        self.maybe(0.3, "to_xyz", "to_xyz")
        noisy = any(stage["name"] == "convert" for stage in self.stages)
        measures = (
            "dynamic_range",
            "exposure_numbers",
            *["exposure_report"] * noisy,
            "lens_numbers",
            "pixel_numbers",
            "illuminance",
        )
        for use in measures:
            self.maybe(0.2, use, use)
        self.maybe(0.1, "resolution", "resolution")

    def demosaicers(self) -> list[str]:
        """Those that can be made for the mask."""
        found = []
        for name in self.able(lambda kind: kind.role == "demosaicing" and set(kind.reads) == {"mosaic_linear"}):
            kind = self.registry.load(name)
            try:
                kind(**({"pattern": self.camera["pattern"]} if "pattern" in parameters_of(kind) else {}))
            except ValueError:
                continue
            found.append(name)
        return found

    # -- files

    def transmission(self, low: float, high: float) -> str:
        nodes = np.linspace(max(low - 30, 1), high + 30, 9)
        rows = [f"{n:.6g},{self.rng.uniform(0.05, 1):.4f}" for n in nodes]
        self.file("transmission.csv").write_text("wavelength_nm,transmission\n" + "\n".join(rows) + "\n")
        return self.file("transmission.csv").name

    def photograph(self) -> str:
        from PIL import Image

        size = (int(self.rng.integers(1, 40)), int(self.rng.integers(1, 40)), 3)
        Image.fromarray(self.rng.integers(0, 256, size, dtype=np.uint8)).save(self.file("photograph.png"))
        return self.file("photograph.png").name

    def bank(self, spacing: float) -> str:
        from etendue_camera.field.psf_bank import PsfBank

        step = np.arange(-5, 6)[:, None]
        spots = [
            [np.exp(-0.5 * ((step / (1 + w)) ** 2 + (step.T / (1 + h)) ** 2)) for w in (0.45, 0.65)] for h in (0.0, 0.5)
        ]
        reach = max(self.rows, self.columns) * self.camera["pixel_pitch"]
        PsfBank(np.array([0.0, reach]), np.array([0.45, 0.65]), spots, spacing, "drawn").save(self.file("bank.npz"))
        return self.file("bank.npz").name


def draw(seed: int, folder: Path, small: bool = False) -> Document:
    """The camera with this seed, which is another where other stages are installed; its files are written into the
    folder.

    ``small``: one that takes half a second, of few pixels behind a plain lens.
    """
    return Drawn(seed, folder, small).document()
