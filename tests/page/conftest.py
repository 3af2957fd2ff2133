"""One small archive with everything that a page shows: two axes, light, a mosaic, display values, figures by stage,
hostile texts.
"""

import base64
import json
import re
import zlib

import numpy as np
import pytest

from etendue.contract.registry import installed_stages
from etendue.pipeline.file import parse_pipeline
from etendue.plan.planner import make_plan
from etendue.present.page.columns import KINDS
from etendue.session import Options, execute

HOSTILE = "</script><script>document.title='owned'</script><img src=x onerror=alert(1)>&amp;"
PIPELINE = f"""
name = "shown"
description = "{HOSTILE}"
seed = 1
[camera]
focal_length = "6.93 mm"
peak_qe = [0.36, 0.44, 0.40]
pixel_pitch = "6 um"
[[stages]]
use = "colorchecker"
name = "scene"
white_luminance = "1000 cd m-2"
width = "120 um"
height = "80 um"
spacing = "2 um"
wavelength_from = "400 nm"
wavelength_to = "700 nm"
bin_width = "100 nm"
[[stages]]
use = "irradiance"
[[stages]]
use = "pixel"
rows = 12
columns = 18
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
use = "balance_mosaic"
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
use = "lens_numbers"
[[stages]]
use = "exposure_report"
[sweep]
f_number = [8, 2, 4]
integration_time = ["2 ms", "8 ms"]
"""


@pytest.fixture(scope="session")
def archive(tmp_path_factory):
    folder = tmp_path_factory.mktemp("page") / "shown"
    execute(make_plan(parse_pipeline(PIPELINE), installed_stages()), folder, Options("serial"))
    return folder


def unpacked(document, place):
    """A column of a document, as a browser takes it out."""
    kind = KINDS[place["kind"]]
    blob = zlib.decompress(base64.b64decode(document["blob"]))
    own = np.frombuffer(blob[place["at"] : place["at"] + place["count"] * kind.itemsize], "u1")
    return own.reshape(kind.itemsize, -1).T.copy().view(kind).ravel()


def embedded_document(html):
    return json.loads(
        re.search(r'<script type="application/json" id="document">(.*?)</script>', html, re.DOTALL).group(1)
    )
