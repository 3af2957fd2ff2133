"""Stages with a table from a file keep what they declare, as the others do."""

import pytest

from etendue.contract.registry import installed_stages
from etendue.testing import StageConformance

TABLES = {
    "even": "{axis},ratio\n0,1.0\n0.02,0.6\n0.05,0.4\n",
    "by_wavelength": "{axis},450,550,650\n0,0.9,1.0,0.95\n0.01,1.1,0.8,0.5\n0.05,0.2,0.3,0.0\n",
    "both_sides": "{axis},ratio\n-90,0.2\n0,1.0\n0.03,1.5\n90,0.1\n",
}
CASES = [
    ("falloff", "even", {"model": "table"}, "height_mm"),
    ("falloff", "by_wavelength", {"model": "table"}, "height_mm"),
    ("falloff", "by_wavelength", {"model": "table", "focal_length": 20.0}, "angle_deg"),
    ("angular_response", "even", {"focal_length": 20.0}, "angle_deg"),
    ("angular_response", "both_sides", {"microlens_shift": 40.0, "exit_pupil_distance": float("inf")}, "angle_deg"),
    ("angular_response", "by_wavelength", {"microlens_shift": -3.0}, "angle_deg"),
]


@pytest.mark.parametrize(("name", "table", "values", "axis"), CASES, ids=lambda v: v if isinstance(v, str) else "")
class TestWithTable(StageConformance):
    @pytest.fixture(autouse=True)
    def _instance(self, name, table, values, axis, tmp_path):
        path = tmp_path / "table.csv"
        path.write_text(TABLES[table].format(axis=axis))
        self.stage = installed_stages().load(name)(table=str(path), **values)


class TestWithDispersion(StageConformance):
    @pytest.fixture(autouse=True)
    def _instance(self, tmp_path):
        path = tmp_path / "scale.csv"
        path.write_text("wavelength_nm,scale\n400,1.1\n700,0.9\n")
        self.stage = installed_stages().load("birefringent")(
            separation_y=2.0, separation_x=3.0, rotation=10.0, dispersion=str(path)
        )
