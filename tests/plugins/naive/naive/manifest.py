"""What this distribution brings: seven stages, and a well-formed twin of each."""

from etendue.api import hookimpl

NAMES = ("Diffusion", "SoftWell", "Gamma", "Variance", "Shade", "Veil", "Scatter")


@hookimpl
def etendue_stages():
    stages = {f"naive_{name.lower()}": f"naive.stages:{name}" for name in NAMES}
    return stages | {f"sound_{name.lower()}": f"naive.sound:{name}" for name in NAMES}


@hookimpl
def etendue_variables():
    return {"unevenness": {"long_name": "variance over the frame", "units": "1"}}
