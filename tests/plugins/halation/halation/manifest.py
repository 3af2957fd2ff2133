"""What this distribution brings: two stages of a new role, a variable, a camera quantity, a sensor, two tables by
wavelength, a kind of plot and sections of a page."""

from pathlib import Path

from etendue.api import hookimpl

HERE = Path(__file__).parent


@hookimpl
def etendue_stages():
    return {"halation": "halation.stages:Halation", "halation_backed": "halation.stages:Backed"}


@hookimpl
def etendue_variables():
    return {
        "halo": {
            "long_name": "share of the light that comes back",
            "units": "percent",
            "shown": "map",
            "range": (0, 20),
        }
    }


@hookimpl
def etendue_quantities():
    return {
        "film_base": {
            "default": 120.0,
            "units": "um",
            "above": 0,
            "long_name": "film base",
            "doc": "thickness of the film's base",
        }
    }


@hookimpl
def etendue_sensors():
    return {"halation-film": HERE / "film.toml"}


@hookimpl
def etendue_roles():
    return {"halation": "light that comes back from behind the sensitive layer"}


@hookimpl
def etendue_spectra():
    return {"halation lamp": HERE / "lamp.csv", "halation film": HERE / "film.csv"}


@hookimpl
def etendue_plots():
    return {
        "glow": {
            "place": "halation.study:glow",
            "takes": 1,
            "doc": "how much light comes back, pixel by pixel",
            "uses": ["at"],
        },
        "nothing": {"place": "halation.study:nothing", "doc": "no plot at all"},
    }


@hookimpl
def etendue_sections():
    return {
        "halation": {"place": "halation.study:section", "title": "Light that comes back"},
        "silent": {"place": "halation.study:silent", "title": "Not on the page"},
        "broken": {"place": "halation.study:broken", "title": "Breaks off"},
        "wrong": {"place": "halation.study:wrong", "title": "Gives something else"},
    }


@hookimpl
def etendue_spelling():
    return {"halo": "HALO"}
