"""Stages agree on what they share: equal names have equal defaults, differences and double physics are noted. In:
installed stages.
"""

import tomllib
from importlib.resources import files

import numpy as np
import pytest
from numpy.testing import assert_allclose

import etendue
from etendue.contract.registry import installed_stages
from etendue.contract.stage import parameters_of
from etendue.contract.values.parameter import MISSING
from etendue.plan.planner import make_plan
from etendue.session import from_document
from etendue_camera.colour.stages.display import Display, ToXyz
from etendue_camera.colour.stages.display_white import MEASURED, white_of
from etendue_camera.colour.stages.tristimulus import Balance

DIFFER = {
    "angle": "of a chart's edge, and of the line along which a curve is taken",
    "background": "of patches that stand on grey, and of points that stand on black",
    "centre_x": "of a scene in mm from the axis, and of a measurement in um from the middle",
    "centre_y": "as centre_x",
    "contrast": "of a star, of a defect against its neighbours, of a picture's spectrum",
    "exponent": "of a gamma, of the sizes of leaves, of a picture's spectrum",
    "file": "of what cannot be without one, and of lists of defects that may be",
    "floor": "of cones and channels, and of dissimilarities",
    "gains": "where they come from, and what they are",
    "highest": "of frequencies on the sensor, and of those of a star's rings, in other units",
    "highest_frequency": "of a chart by itself, and of one panel of the composite",
    "largest_gain": "of shading, and of a restoration",
    "low": "of charts that are steps of density, and of edges",
    "method": "of computing, and of finding a white",
    "nodes": "of tables of different functions",
    "oversampling": "of painted leaves, and of a spline",
    "power": "of a cosine, of glare, of a mean",
    "radius": "of a chart, of glare, and of filters in pixels",
    "reflectances": "required of a chart that shows them; of a fit the ColorChecker's",
    "spacing": "of a scene, and of a cube that has its own",
    "strength": "of a correction that is meant in full, and of a sharpening",
    "target": "a white, and a level",
    "threshold": "in sigmas of noise, and of a mask in display values",
    "white_luminance": "required of a scene; of a cube that may have a level",
}

# of the distributions beside this one, where they are installed: a name with another default than ours, and why
ABROAD = {
    "heights": "of a ray-traced lens as many as its own aberrations ask, unless they are said",
    "pupil_samples": "of a lens that is traced rays are dear, and settings reach as far as it needs",
    "reference_wavelength": "of a whole ray-traced lens a camera quantity, which several of its stages share",
    "tolerance": "of the convolution of a ray-traced lens, as a share of its own errors",
}


def document(*stages, camera=None, scene=None):
    start = {
        "use": "uniform",
        "name": "scene",
        "white_luminance": 100.0,
        "width": 60.0,
        "height": 60.0,
        "bin_width": 40.0,
        **(scene or {}),
    }
    return {
        "name": "agree",
        "precision": "float64",
        "camera": {"peak_qe": [0.4, 0.5, 0.3], **(camera or {})},
        "stages": [start, {"use": "irradiance"}, *({"use": s} if isinstance(s, str) else s for s in stages)],
    }


def notes(*stages, **tables):
    return make_plan(from_document(document(*stages, **tables)), installed_stages()).warnings


SENSOR = (
    "pixel",
    "mosaic",
    "exposure",
    "shot_noise",
    "full_well",
    "read_noise",
    "adc",
    "linearise",
    "white",
    "balance_mosaic",
)
COLOUR = ("demosaic_bilinear", "colour_fit", "camera_to_xyz")


def test_equal_names_have_equal_defaults_or_a_reason():
    """Whatever else is installed: what strangers call their parameters is theirs."""
    registry, found, own = installed_stages(), {}, {}
    beside = tomllib.loads((files("etendue_camera") / "data" / "plugins.toml").read_text())
    for name in registry.names():
        distribution = registry.installed(name).distribution
        if distribution != "etendue" and distribution not in beside:
            continue
        for parameter, (known, _, default) in parameters_of(registry.load(name)).items():
            value = "required" if default is MISSING else repr(default)
            found.setdefault(parameter, set()).add((value, known.units, known.shared))
            if distribution == "etendue":
                own.setdefault(parameter, set()).add((value, known.units, known.shared))
    assert {name for name, values in found.items() if len(values) > 1} <= {*DIFFER, *ABROAD}
    assert {name for name, values in own.items() if len(values) > 1} == set(DIFFER)  # no reason that has become idle


def test_what_stages_assume_by_default_agrees():
    registry, found = installed_stages(), {}
    for name in registry.names():
        kind = registry.load(name)
        if hasattr(kind, "assumes") and not any(default is MISSING for _, _, default in parameters_of(kind).values()):
            for what, value in kind().assumes().items():
                found.setdefault(what, {}).setdefault(value, []).append(name)
    assert {"the display", "the white of the display", "the encoding", "the fall-off"} <= set(found)
    for what, values in found.items():
        assert len(values) == 1, (what, values)


def test_a_display_shows_the_tristimulus_values_that_it_was_given():
    """With the defaults of both stages the way there and back is the identity, to rounding of a 3 x 3 inverse."""
    xyz = np.random.default_rng(5).uniform(0.1, 0.9, (3, 4, 5))
    shown = Display().run(xyz, Display().prepare({}))["rgb_linear"]
    assert_allclose(ToXyz().run(shown, ToXyz().prepare({}))["xyz_display"], xyz, atol=2e-15)


@pytest.mark.parametrize(
    ("target", "display"),
    [
        ("D65", "sRGB"),
        ("sRGB", "sRGB"),
        ("D65", "ITU-R BT.2020"),
        ("D65", "Display P3"),
        ("D50", "ProPhoto RGB"),
        ("E", "CIE RGB"),
        *((name, name) for name in MEASURED),
    ],
)
def test_white_balanced_to_the_white_of_the_display_is_one_in_every_channel(target, display):
    """Whatever the scene's light is: to rounding of two 3 x 3 inverses."""
    balance, display = Balance(target=target), Display(display=display)
    white = np.array([1.0985, 1.0, 0.3558])  # illuminant A
    seen = balance.run(white[:, None, None], white, balance.prepare({}))["xyz_scene"]
    assert_allclose(display.run(seen, display.prepare({}))["rgb_linear"], 1, atol=1e-13)


def test_white_is_one_in_every_channel_through_the_whole_camera():
    """The scene's white as the camera computes it: what the demosaicer and the fit make of a noise-free white field."""
    tree = etendue.simulate({**document(*SENSOR, *COLOUR, "balance"), "wanted": ["colour_fit.white_xyz"]})
    white = tree["colour_fit"].white_xyz.values
    balanced = Balance().run(white[:, None, None], white, Balance().prepare({}))["xyz_scene"]
    assert_allclose(Display().run(balanced, Display().prepare({}))["rgb_linear"], 1, atol=1e-13)


def test_an_illuminant_has_its_published_white_and_its_spectrum_nearly_the_same():
    # sums over rows of 5 nm from 380 to 780 nm: 2e-4 in Z
    spectral = {"D65": (0.95047, 1.08883), "A": (1.09850, 0.35585), "D50": (0.96422, 0.82521)}
    for name, (x, z) in spectral.items():
        assert_allclose(white_of(name), [x, 1, z], atol=4e-4)


def test_displays_and_encodings_that_differ_are_noted():
    behind = (*SENSOR, *COLOUR, "balance", "display", "encode", "to_xyz")
    assert not [text for text in notes(*behind) if " here, but " in text]
    other = (*SENSOR, *COLOUR, "balance", {"use": "display", "display": "Display P3"}, "encode", "to_xyz")
    said = [text for text in notes(*other) if " here, but " in text]
    assert said == ["to_xyz: the display is sRGB here, but Display P3 in 'display', earlier on its path"]
    measured = (*SENSOR, *COLOUR, "balance", {"use": "display", "display": "Apple Studio Display"}, "encode")
    said = [text for text in notes(*measured) if " here, but " in text]
    assert said == [
        "display: the white of the display is Apple Studio Display here, but D65 in 'balance', earlier on its path"
    ]
    decoded = (*SENSOR, *COLOUR, "balance", "display", {"use": "encode", "encoding": "power"}, "decode")
    said = [text for text in notes(*decoded) if " here, but " in text]
    assert said == ["decode: the encoding is sRGB here, but power 0.45 in 'encode', earlier on its path"]


def test_a_correction_that_takes_the_lens_for_another_is_noted():
    sensor = ("pixel", "mosaic", "exposure", "shot_noise", "full_well", "read_noise", "adc", "linearise")
    assert not [text for text in notes("falloff", *sensor, "lens_shading") if " here, but " in text]
    said = notes({"use": "falloff", "model": "disc"}, *sensor, "lens_shading")
    assert any("the fall-off is cos4 physical here, but disc physical in 'falloff'" in text for text in said)
    said = notes("falloff", {"use": "angular_response", "power": 1.5}, *sensor, "lens_shading")
    assert any("the response by angle is power 0 here, but power 1.5 in 'angular_response'" in text for text in said)


@pytest.mark.parametrize(
    ("first", "second", "what"),
    [
        ("falloff", {"use": "falloff", "name": "again"}, "fall-off"),
        ("diffraction", {"use": "diffraction", "name": "again"}, "diffraction"),
        ("diffraction", "wavefront", "diffraction"),
        ("wavefront", "diffraction", "diffraction"),
        ("wavefront", {"use": "aberrations"}, "diffraction"),
        ("diffusion", {"use": "diffusion", "name": "again"}, "diffusion of charge"),
        ("angular_response", {"use": "angular_response", "name": "again"}, "angular response"),
        ("distortion", {"use": "distortion", "name": "again"}, "distortion"),
    ],
)
def test_physics_that_light_meets_twice_is_noted(first, second, what):
    assert any(f"{what} counts twice" in text for text in notes(first, second))


def test_physics_counts_on_every_way_that_leads_to_a_stage():
    """A filter reads the light of the picture behind the first stage, and that of the white from before it."""
    twice = ("diffraction", "optical_filter", {"use": "diffraction", "name": "again"})
    assert any("again: diffraction counts twice" in text for text in notes(*twice))


def test_two_filters_two_rims_and_alternatives_beside_one_another_are_not_noted():
    assert not any("twice" in text for text in notes("optical_filter", {"use": "optical_filter", "name": "other"}))
    beside = ("falloff", {"use": "falloff", "name": "other", "from": {"irradiance": "irradiance"}})
    assert not any("twice" in text for text in notes(*beside))
    assert not any("twice" in text for text in notes("lens_gaussian", "diffraction", "falloff", "vignetting"))


# ------------------------------------------------------------------------------------------------ the pixel


def test_one_peak_efficiency_serves_all_channels():
    def rate(**camera):
        return etendue.simulate(document("pixel", camera=camera))["pixel"].photon_rate.values

    def swept(values):
        asked = document("pixel") | {"sweep": {"peak_qe": values}}
        del asked["camera"]["peak_qe"]
        return etendue.simulate(asked)["pixel"].photon_rate

    listed = rate(peak_qe=[0.7, 0.7, 0.7])
    np.testing.assert_array_equal(rate(peak_qe=0.7), listed)
    np.testing.assert_array_equal(rate(peak_qe=[0.7]), listed)
    np.testing.assert_array_equal(rate(peak_qe=1), rate(peak_qe=[1.0, 1.0, 1.0]))
    np.testing.assert_array_equal(swept([0.3, 0.7]).sel(peak_qe=0.7).values, listed)
    with pytest.raises(etendue.errors.RequestError, match="an axis takes one value per step, not a list of several"):
        swept([[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]])
    with pytest.raises(etendue.errors.RequestError, match="peak_qe.*1.5 is out of range"):
        rate(peak_qe=1.5)


def test_a_surface_that_the_efficiency_holds_already_is_noted():
    assert any(
        "surface_transmission = 0.9 has no effect" in text
        for text in notes("pixel", camera={"surface_transmission": 0.9})
    )
    told = notes("pixel", camera={"surface_transmission": 0.9, "sensitivity_kind": "filter_transmittance"})
    assert not any("has no effect" in text for text in told)
    assert any(
        "sensitivity_per = 'energy' has" in text
        for text in notes("pixel", camera={"sensitivity": "flat", "sensitivity_per": "energy"})
    )
