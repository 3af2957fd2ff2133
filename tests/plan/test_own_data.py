"""Tables of one's own: what the plan says that it does with them."""

import pytest

from etendue.contract.registry import installed_stages
from etendue.pipeline.file import parse_pipeline
from etendue.plan.planner import make_plan
from tests.plan.given import SCENE, SENSOR

CAMERA = """
[camera]
{}
f_number = 4
pixel_pitch = "5 um"
full_well_density = "1000 electron um-2"
integration_time = "8 ms"
sensitivity = "qe.csv"
"""
PEAKS = (0.46, 0.55, 0.47)


def warnings(folder, camera, columns, **overrides):
    """Of a plan whose sensitivity has these peaks at 450, 550 and 600 nm."""
    rows = [(380, 0.5), (450, 1.0), (550, 1.0), (600, 1.0), (720, 0.5)]
    lines = [",".join(str(one) for one in (nm, *(share * peak for peak in columns))) for nm, share in rows]
    (folder / "qe.csv").write_text("wavelength_nm,R,G,B\n" + "\n".join(lines))
    text = CAMERA.format(camera) + SCENE.format(scene="uniform").replace('spacing = "1 um"', "") + SENSOR
    return make_plan(parse_pipeline(text, folder=folder, overrides=overrides), installed_stages()).warnings


@pytest.mark.parametrize(
    ("camera", "columns", "said"),
    [
        ("peak_qe = [0.36, 0.44, 0.40]", PEAKS, "use them unscaled, set peak_qe = [0.46, 0.55, 0.47]"),
        ("peak_qe = 0.5", PEAKS, "scaled to peak_qe = [0.5, 0.5, 0.5]"),
        ("peak_qe = [0.46, 0.55, 0.47]", PEAKS, ""),
        ("peak_qe = [0.36, 0.44, 0.40]", (1.0, 1.0, 1.0), ""),  # relative
        ("peak_qe = [0.36, 0.44, 0.40]", (46, 55, 47), ""),  # of another unit
    ],
)
def test_a_table_that_looks_absolute_is_told_to_be_scaled(tmp_path, camera, columns, said):
    found = [one for one in warnings(tmp_path, camera, columns) if "peak_qe" in one]
    assert (any(said in one for one in found)) if said else not found, found


@pytest.mark.parametrize(("more", "said"), [("", True), ("\npeak_qe = [0.4, 0.4, 0.4]", False)])
def test_the_peaks_of_a_named_sensor_are_told_where_only_the_curves_are_given(tmp_path, more, said):
    found = warnings(tmp_path, f'sensor = "sony-imx174"{more}', (1.0, 1.0, 1.0))
    told = [one for one in found if "comes from the sensor sony-imx174" in one]
    assert any("peak_qe" in one for one in told) == said


def test_so_is_what_a_sensor_says_of_its_own_curves(tmp_path):
    """Per photon or per energy, with filters or without: an own table may be another."""
    given = 'body = "Sony ILCE-7RM2"\npeak_qe = [0.4, 0.4, 0.4]'
    told = [one for one in warnings(tmp_path, given, (1.0, 1.0, 1.0)) if "sensitivity_per = 'energy' comes from" in one]
    assert len(told) == 1
    own = f'{given}\nsensitivity_per = "photon"'
    assert not any("sensitivity_per" in one for one in warnings(tmp_path, own, (1.0, 1.0, 1.0)))
