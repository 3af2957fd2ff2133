"""Light of many bands: streamed as whole, expanded as exact. In: small pipelines, the threshold lowered. Out: equal
planes.
"""

import numpy as np
import pytest

import etendue
from etendue.archive.read.reading import open_archive
from etendue.archive.structure import cutting
from etendue.compute.tables import TABLES
from etendue.errors import PluginError, RequestError
from etendue.plan import cost
from etendue.testing.examples import BlurAndSum
from etendue.transfer import expansion, products, sampling


def camera(**pixel):
    return {
        "name": "bands",
        "precision": "float64",
        "camera": {"peak_qe": [0.4, 0.5, 0.3], "pixel_pitch": 2.0},
        "stages": [
            {
                "use": "composite",
                "name": "scene",
                "white_luminance": 100,
                "width": 120,
                "height": 80,
                "wavelength_from": 400,
                "wavelength_to": 700,
                "bin_width": 20,
            },
            {"use": "irradiance"},
            {"use": "falloff"},
            {"use": "optical_filter"},
            {"use": "diffraction"},
            {"use": "diffusion"},
            {"use": "pixel", **pixel},
            {"use": "white"},
        ],
    }


@pytest.fixture
def by_band(monkeypatch):
    """Everything with a wavelength is too large to be held."""
    monkeypatch.setattr(cost, "LARGEST_WHOLE", 1000)
    monkeypatch.setattr(cutting, "LARGEST_CHUNK", 8000)  # and a plane too large to be one chunk


def test_light_streamed_by_band_gives_what_the_whole_gives(by_band, monkeypatch):
    streamed = etendue.simulate(camera())
    monkeypatch.undo()
    whole = etendue.simulate(camera())
    for stage in ("scene", "irradiance", "falloff", "optical_filter"):
        for name, values in whole[stage].data_vars.items():
            assert np.array_equal(streamed[stage][name].values, values.values), (stage, name)
    for stage, name in (("diffraction", "irradiance"), ("diffusion", "irradiance"), ("pixel", "photon_rate")):
        truth = whole[stage][name].values
        # linear look-up in 8192 radial frequencies: 6e-6 at the kink of the cut-off, where the scene holds a tenth of
        # its contrast
        np.testing.assert_allclose(streamed[stage][name].values, truth, atol=4e-7 * truth.max(), rtol=0)
    assert np.array_equal(streamed["white"].white.values, whole["white"].white.values)


def test_what_looks_at_light_is_given_arrays_also_of_light_that_is_streamed(by_band, monkeypatch):
    """The budget of light takes means of what it is given: nothing in it knows of bands."""
    asked = {**camera(), "stages": [*camera()["stages"], {"use": "light_budget"}]}
    streamed = etendue.simulate(asked)["light_budget"].mean_irradiance
    monkeypatch.undo()
    whole = etendue.simulate(asked)["light_budget"].mean_irradiance
    assert list(streamed.stage.values) == list(whole.stage.values)
    assert len(whole) >= 4  # one for each stage that writes it
    np.testing.assert_allclose(
        streamed.values, whole.values, rtol=1e-6
    )  # a look-up of radial frequencies keeps the mean to that


def test_what_is_streamed_has_the_same_bits_however_it_is_run_and_resumed(by_band, tmp_path):
    first = etendue.simulate(camera(), archive=tmp_path / "a", scheduler="serial")
    second = etendue.simulate(camera(), archive=tmp_path / "b", scheduler="threads", workers=2)
    for chunk in (tmp_path / "b" / "data.zarr" / "pixel" / "photon_rate").glob("c*"):
        chunk.unlink()
    etendue.simulate(camera(), archive=tmp_path / "b", scheduler="threads", workers=2)
    # nothing but the last stage's result is kept: the light is made again instead of being read back
    lean = etendue.simulate({**camera(), "keep": ["pixel"]}, archive=tmp_path / "c")
    for stage in ("falloff", "diffusion", "pixel"):
        for name, values in first[stage].data_vars.items():
            assert np.array_equal(second[stage][name].values, values.values, equal_nan=values.dtype.kind == "f")
    assert np.array_equal(lean["pixel"].photon_rate.values, first["pixel"].photon_rate.values)
    (cell,) = (c for c in open_archive(tmp_path / "a").cells.values() if c.stage == "falloff")
    windows = [chunk.window for chunk in cell.chunks if chunk.variable == "irradiance"]
    bands = list(dict.fromkeys(window[0][0] for window in windows))
    assert bands == list(range(len(bands)))
    assert len(windows) > len(bands) >= 8


def test_a_stage_that_needs_the_whole_of_a_streamed_variable_gets_it(by_band, monkeypatch):
    document = camera()
    document["stages"][2] = {"use": "distortion", "k1": -0.01}
    streamed = etendue.simulate(document)["pixel"].photon_rate.values
    monkeypatch.undo()
    # as far as the radial look-up of the transfer functions reaches
    np.testing.assert_allclose(streamed, etendue.simulate(document)["pixel"].photon_rate.values, rtol=1e-6)


def test_an_expansion_over_wavelength_converges_within_its_stated_error():
    exact = etendue.simulate(camera(), leave_out=False)["pixel"].photon_rate.values
    before = np.inf
    for terms in (3, 5, 7, 9):
        tree = etendue.simulate(camera(wavelength_terms=terms), leave_out=False)
        rest = tree["pixel"].photon_rate.values - exact
        error = (np.sqrt((rest**2).mean(axis=(1, 2))) / exact.max(axis=(1, 2))).max()
        ledger = tree["ledger"].to_dataset()
        stated = float(ledger.error.values[[str(s) for s in ledger.stage.values].index("pixel")])
        assert error <= stated
        assert error < 0.7 * before
        before = error
    assert before < 3e-5


def test_as_many_terms_as_bands_are_no_expansion():
    exact = etendue.simulate(camera(), leave_out=False)["pixel"].photon_rate.values
    # fifteen bands: fourteen terms leave nothing, the radial look-up remains
    found = etendue.simulate(camera(wavelength_terms=14), leave_out=False)["pixel"].photon_rate.values
    np.testing.assert_allclose(found, exact, rtol=1e-6)


def test_an_expansion_leaves_uniform_light_exact():
    document = camera(wavelength_terms=3)
    document["stages"][0] = {**document["stages"][0], "use": "uniform"}
    del document["stages"][2]  # the fall-off, behind which light is not uniform
    exact = {
        **document,
        "stages": [{k: v for k, v in s.items() if k != "wavelength_terms"} for s in document["stages"]],
    }
    one, all_ = (etendue.simulate(d, leave_out=False)["pixel"].photon_rate.values for d in (document, exact))
    np.testing.assert_allclose(one, all_, rtol=1e-12)


PITCHES = tuple(float(pitch) for pitch in np.linspace(2.0, 6.0, 10))


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_pixels_of_every_size_share_the_transforms_of_their_light(monkeypatch, precision):
    """The weights of ten sizes differ in their last bits; the light is gathered into planes and transformed once."""
    made = []
    monkeypatch.setattr(sampling, "transform", lambda *given, real=sampling.transform: made.append(1) or real(*given))
    document = camera(wavelength_terms=3, rows=8, columns=12) | {"precision": precision}
    document["camera"] |= {"peak_qe": [0.36, 0.44, 0.40], "aperture_fraction": 0.741}
    document["stages"][0] |= {"wavelength_to": 720}

    def transforms_of(*pitches):
        TABLES.clear()
        made.clear()
        document["sweep"] = {"pixel_pitch": list(pitches)}
        found = list(etendue.simulate(document, leave_out=False)["pixel"].subtree)[-1]
        return found["photon_rate"].values, len(made)

    together, count = transforms_of(*PITCHES)
    for one, pitch in zip(together, PITCHES, strict=True):
        alone, own = transforms_of(pitch)
        assert own == count
        np.testing.assert_array_equal(one, np.squeeze(alone))


class Lopsided(BlurAndSum):
    """A sum whose shares are not its weights."""

    def shares(self, prepared):
        return np.full_like(prepared, 0.5)


def test_shares_that_are_not_those_of_the_weights_are_refused():
    weights = np.array([[1.0, 3.0], [0.0, 0.0]])
    assert products.shares(BlurAndSum(), weights, weights).tolist() == [[0.25, 0.75], [0.0, 0.0]]
    with pytest.raises(PluginError, match="Lopsided.shares must give the weights divided by the sum of their channel"):
        products.shares(Lopsided(), weights, weights)


def test_fewer_terms_than_channels_are_refused():
    with pytest.raises(RequestError, match="has 3 channels; use at least as many terms, or 0"):
        etendue.simulate(camera(wavelength_terms=2))


def test_a_basis_holds_the_weights_and_more_functions_leave_less():
    random = np.random.default_rng(0)
    weights, transfer, passed = random.random((3, 9)), random.random((9, 40)), np.ones(40)
    weights[:, 3] = 0.0  # a band that nothing sees
    transfer[:, 0] = 1.0  # zero frequency
    left = np.inf
    for planes in (3, 5, 7, 8):
        basis = expansion.band_basis(weights, planes, transfer, passed)
        rest = expansion.expansion_residual(weights, transfer, basis)
        np.testing.assert_allclose(rest[:, :, 0], 0, atol=1e-13)  # of the weights themselves nothing is left out
        now = np.sqrt((rest**2).mean())
        assert now < left
        left = now
    assert left < 1e-13  # eight bands with weight, eight functions


@pytest.mark.parametrize(("ny", "nx"), [(33, 40), (40, 33), (1, 7), (64, 64)])
def test_a_radial_table_is_looked_up_on_every_row_of_a_transform(ny, nx):
    rows, columns = sampling.frequencies(ny, 0.7, half=False), sampling.frequencies(nx, 0.7, half=True)
    plane = expansion.RadialPlane(rows, columns, "float64")
    spectrum = np.ones((rows.size, columns.size), complex)
    plane.multiply(spectrum, np.exp(-(plane.nodes**2)))
    truth = np.exp(-(np.hypot(rows[:, None], columns[None, :]) ** 2))
    # linear interpolation: (highest frequency / 8192)^2 / 8 times a second derivative below 2
    np.testing.assert_allclose(spectrum.real, truth, atol=1e-8)


def test_simulate_leaves_the_document_it_is_given_as_it_was():
    document = camera()
    etendue.simulate(document, pixel__wavelength_terms=5, f_number=4)
    assert document == camera()


def test_a_stored_scene_serves_as_the_light_of_another_camera(tmp_path):
    kept = etendue.simulate(camera(), archive=tmp_path / "first")
    document = camera()
    document["stages"][0] = {
        "use": "radiance_cube",
        "name": "scene",
        "file": str(tmp_path / "first" / "data.zarr"),
        "variable": "scene/radiance",
    }
    again = etendue.simulate(document)
    for stage, name in (
        ("scene", "radiance"),
        ("scene", "white_radiance"),
        ("pixel", "photon_rate"),
        ("white", "white"),
    ):
        assert np.array_equal(again[stage][name].values, kept[stage][name].values), name
    document["stages"][0] |= {"variable": "scene/brightness"}
    with pytest.raises(RequestError, match="has no variable 'scene/brightness'"):
        etendue.simulate(document)
