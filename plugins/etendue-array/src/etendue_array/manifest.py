"""What this distribution provides: stages, and the quantities and names that they share."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from etendue.api import hookimpl

HERE = Path(__file__).parent


@hookimpl
def etendue_stages() -> dict[str, str]:
    return {
        "plane_wave": "etendue_array.sound:PlaneWave",
        "second_wave": "etendue_array.sound:SecondWave",
        "microphone_noise": "etendue_array.hearing:MicrophoneNoise",
        "phasors": "etendue_array.hearing:Phasors",
        "delay_and_sum": "etendue_array.beam:DelayAndSum",
        "beam_figures": "etendue_array.beam:BeamFigures",
    }


@hookimpl
def etendue_roles() -> dict[str, str]:
    return {
        "sound": "the sound waves at the microphones",
        "interference": "sound from other directions",
        "self noise": "self noise of every microphone",
        "filter bank": "from time signals to phasors by frequency",
        "beamforming": "from the phasors of all microphones to power by direction",
        "measure of a beam": "metrics of a beam",
    }


@hookimpl
def etendue_tables() -> dict[str, Any]:
    """Quantities shared by stages are set under [array]."""
    return {"array": {}}


@hookimpl
def etendue_quantities() -> dict[str, Any]:
    return {
        "microphones": {"default": 8, "at_least": 1, "at_most": 1024, "doc": "number of microphones in the line"},
        "spacing": {
            "default": 0.08,
            "units": "m",
            "above": 0,
            "at_most": 100,
            "doc": "distance between neighbouring microphones",
        },
        "sound_speed": {
            "default": 343.0,
            "units": "m s-1",
            "at_least": 1,
            "at_most": 1e5,
            "doc": "speed of sound in the medium, such as air or water",
        },
        "tone": {"default": 2000.0, "units": "Hz", "above": 0, "at_most": 1e6, "doc": "frequency of the sound"},
        "bearing": {
            "default": 20.0,
            "units": "deg",
            "at_least": -90,
            "at_most": 90,
            "doc": "direction of arrival; 0 is the normal of the line",
        },
    }


@hookimpl
def etendue_variables() -> dict[str, Any]:
    return {
        "pressure": {"long_name": "sound pressure at the microphones", "units": "Pa"},
        "phasor": {"long_name": "phasor of the sound pressure, rms", "units": "Pa"},
        "beam": {"long_name": "power of the beam, as the square of a sound pressure", "units": "Pa2"},
        "white_noise_gain": {
            "long_name": "signal-to-noise ratio of the beam over that of a microphone",
            "units": "1",
            "better": "higher",
        },
        "bearing_found": {"long_name": "estimated direction of the strongest sound", "units": "deg"},
        "bearing_error": {"long_name": "estimated minus true direction", "units": "deg"},
        "beam_width": {"long_name": "width of the main lobe at half power", "units": "deg", "better": "lower"},
        "side_lobe": {"long_name": "highest side lobe over the main lobe", "units": "dB", "better": "lower"},
        "sound_level": {"long_name": "sound pressure level of the main lobe", "units": "dB"},
    }


@hookimpl
def etendue_dims() -> dict[str, Any]:
    """Units of dims, and example coordinates for trials of stages."""
    return {
        "microphone": {"units": "m", "example": [-0.2 + 0.08 * n for n in range(6)]},
        "time": {"units": "s", "example": [n / 16000 for n in range(64)]},
        "frequency": {"units": "Hz", "example": [500.0 + 250.0 * n for n in range(9)]},
        "direction": {"units": "deg", "example": [-90.0 + 5.0 * n for n in range(37)]},
        "part": {"example": ["real", "imaginary"]},
    }


@hookimpl
def etendue_templates() -> dict[str, Any]:
    return {"array": {"path": HERE / "beginning.toml", "keep": {"all": "everything", "beam": "the beam only"}}}


@hookimpl
def etendue_beginnings() -> dict[str, str]:
    return {"interference": "second_wave", "self noise": "microphone_noise", "beamforming": "delay_and_sum"}
