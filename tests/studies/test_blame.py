"""Who is blamed for an error is who brings it, and nobody else, however large an error of its own it states."""

import pytest

from etendue.accuracy import blame as blaming
from etendue.accuracy.blame import blamed
from etendue.accuracy.holding import Asked, missed
from etendue.accuracy.measuring import GlobalError, MeasuredErrors, Measurement
from etendue.contract.registry import installed_stages
from etendue.session import load
from tests.plan.given import CAMERA, SCENE, SENSOR

TEXT = CAMERA + SCENE.format(scene="composite") + SENSOR
EXACT = {
    "diffusion.nodes": 0,
    "pixel.wavelength_terms": 0,
    "pixel.kept_frequencies": 1,
    "shot_noise.exact_below": "inf",
}


def blame(asked, text=TEXT, **overrides):
    """Shares by decision, and the largest error. The chart states an error of its own, of 2e-4: it stands in both
    runs.
    """
    pipeline = load(text, {"wanted": ["photon_rate"], "precision": "float64", **overrides})
    measurement = Measurement(pipeline, installed_stages())
    found = measurement.errors()
    plan = measurement.plan(measurement.pipeline)
    return blamed(
        measurement, plan, found, missed(found, Asked(asked), "rms"), dict.fromkeys(found.errors, asked), "rms"
    ), found.worst


def test_the_one_stage_that_is_not_as_in_the_reference_brings_the_whole_error():
    found, worst = blame(1e-9, tolerance=1e-2, **EXACT)
    assert found == {
        "falloff left out": pytest.approx(worst, rel=1e-3)
    }  # what is left is what exact stages differ by in rounding


def test_of_several_decisions_the_one_that_brings_most_stands_first():
    found, worst = blame(
        1e-9, tolerance=1e-2, **{name: value for name, value in EXACT.items() if name != "pixel.kept_frequencies"}
    )
    assert next(iter(found)) == "pixel.kept_frequencies"
    assert found["pixel.kept_frequencies"] > 0.9 * worst  # fall-off by itself brings 7e-6 of 1.4e-3


def test_single_precision_is_named():
    found, worst = blame(1e-12, tolerance=0, precision="float32", **EXACT)
    assert found == {"precision float32": pytest.approx(worst, rel=1e-3)}


def test_where_the_reference_itself_is_in_doubt_the_stage_with_the_finite_setting_is_named():
    found, worst = blame(1e-12, TEXT + '[[stages]]\nuse = "resolution"\n', wanted=["resolution.aliasing"], tolerance=0)
    assert worst == 0
    assert list(found) == ["the reference's resolution (point_nodes, nodes)"]


def test_a_stage_of_which_nothing_finer_is_to_be_had_is_named():
    lens = '[[stages]]\nuse = "aberrations"\nheights = 2\nbands = 1\npupil_samples = 32\ncoma = "20 nm"\n'
    text = TEXT.replace('[[stages]]\nuse = "diffraction"\n', lens)
    found, _ = blame(1e-6, text, tolerance=0, **EXACT)
    assert next(iter(found)) == "aberrations.accuracy, which has no finer setting"


@pytest.mark.parametrize(
    ("shares", "named"),
    [
        ({"lens": 0.01, "pixel": 1.0, "noise": 0.2}, ["pixel", "noise"]),  # less than a twentieth of the largest
        ({"lens": 0.0, "pixel": 0.0}, []),
        ({"lens": -1e-3, "pixel": 0.0}, []),
    ],
)
def test_only_what_has_a_share_worth_naming_is_named_and_the_largest_first(shares, named, monkeypatch):
    monkeypatch.setattr(blaming, "_of_decisions", lambda *_: shares)
    far = MeasuredErrors({"photon_rate": GlobalError(1.0, 1.0, 1.0, "measured")}, 1, 0.0)
    assert list(blamed(None, None, far, ("photon_rate",), {"photon_rate": 1e-3}, "rms")) == named
