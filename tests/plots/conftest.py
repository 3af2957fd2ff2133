"""One small sweep for all plots, in memory and as an archive: 3 f-numbers x 2 pitches x 2 times, shapes by pitch,
curves and pictures.
"""

import pytest

import etendue

PIPELINE = """
name = "plotted"
seed = 1
[camera]
peak_qe = [0.36, 0.44, 0.40]
focal_length = "6.93 mm"
full_well_density = "2000 electron um-2"
[[stages]]
use = "slanted_edge"
name = "scene"
white_luminance = "1000 cd m-2"
width = "60 um"
height = "45 um"
bin_width = "100 nm"
[[stages]]
use = "irradiance"
[[stages]]
use = "diffraction"
[[stages]]
use = "pixel"
sensor_width = "0.048 mm"
sensor_height = "0.036 mm"
[[stages]]
use = "mosaic"
[[stages]]
use = "exposure"
[[stages]]
use = "shot_noise"
[[stages]]
use = "adc"
[[stages]]
use = "linearise"
[[stages]]
use = "white"
[[stages]]
use = "demosaic_bilinear"
name = "demosaic"
[[stages]]
use = "colour_fit"
[[stages]]
use = "camera_to_xyz"
[[stages]]
use = "display"
[[stages]]
use = "encode"
[[stages]]
use = "dynamic_range"
[[stages]]
use = "exposure_report"
[[stages]]
use = "resolution"
[sweep]
f_number = [2, 2.8, 5.6]
pixel_pitch = ["3 um", "4 um"]
integration_time = ["2 ms", "8 ms"]
"""


@pytest.fixture(scope="session")
def archive(tmp_path_factory):
    folder = tmp_path_factory.mktemp("plots") / "plotted"
    etendue.simulate(PIPELINE, archive=folder)
    return folder


@pytest.fixture(scope="session")
def tree(archive):
    """Read once; who changes something of it copies it first."""
    from etendue.present.plots.opening import opened

    return opened(archive).load()


@pytest.fixture(scope="session")
def holdings(tree):
    from etendue.present.plots.holdings import Holdings

    return Holdings(tree)
