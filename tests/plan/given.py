"""Small pipelines the planning tests share. Nothing in them is ever computed unless a test says so."""

from etendue.contract.registry import installed_stages
from etendue.pipeline.file import parse_pipeline
from etendue.plan.planner import make_plan

CAMERA = """
[camera]
peak_qe = [0.36, 0.44, 0.40]
"""

SCENE = """
[[stages]]
use = "{scene}"
name = "scene"
white_luminance = "1000 cd m-2"
width = "48 um"
height = "48 um"
spacing = "1 um"
wavelength_from = "400 nm"
wavelength_to = "700 nm"
bin_width = "100 nm"
"""

SENSOR = """
[[stages]]
use = "irradiance"
[[stages]]
use = "falloff"
[[stages]]
use = "diffraction"
[[stages]]
use = "lens_gaussian"
[[stages]]
use = "diffusion"
[[stages]]
use = "pixel"
rows = 8
columns = 8
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
"""

RECONSTRUCTION = """
[[stages]]
use = "demosaic_bilinear"
name = "demosaic"
[[stages]]
use = "sharpen"
"""


def chain(scene="slanted_edge", head="", tail="", sweep=""):
    """A camera from scene to sharpened picture, as TOML."""
    axes = f"\n[sweep]\n{sweep}\n" if sweep else ""
    return head + CAMERA + SCENE.format(scene=scene) + SENSOR + RECONSTRUCTION + tail + axes


def plan_of(text, overrides=None, folder=None, leave_out=True):
    """The plan of a TOML text."""
    keywords = {"folder": folder} if folder is not None else {}
    return make_plan(parse_pipeline(text, overrides=overrides, **keywords), installed_stages(), leave_out)


def keys_of(plan):
    """Keys of every cell by stage."""
    return {node.name: [cell.key for cell in plan.of(node.name)] for node in plan.nodes}


def changed(one, other):
    """Stages some of whose keys differ between two plans."""
    mine, theirs = keys_of(one), keys_of(other)
    return {name for name in mine if mine[name] != theirs.get(name)}
