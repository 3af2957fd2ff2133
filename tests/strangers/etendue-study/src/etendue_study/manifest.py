"""What this distribution brings: a command and a method of pipelines."""

from etendue.api import hookimpl


@hookimpl
def etendue_commands():
    doc = "which figure moves most when a quantity moves"
    return {"slopes": {"place": "etendue_study.command:slopes", "usage": "FILE NAME=V,V", "doc": doc}}


@hookimpl
def etendue_methods():
    return {"Pipeline.slopes": "etendue_study.study:slopes"}
