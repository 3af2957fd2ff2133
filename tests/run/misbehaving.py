"""A plugin whose stage misbehaves in the way it is told to, and a sound one behind it. Installed as a folder on
PYTHONPATH.
"""

import ctypes
import os
import signal
import sys
import threading
import time
import warnings
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from etendue.api import Bands, Facts, Grid, Line, Source, Stage, hookimpl, param

LIGHT = "wavelength y x [W m-2 nm-1]"
KEPT = []  # what a stage goes on holding
BUFFER = np.empty((1, 8, 9))
VIEW = BUFFER[:]


class Unfriendly(Exception):
    def __str__(self):
        raise SystemExit(0)


class Stuck(Exception):
    def __init__(self, one, two):
        super().__init__("cannot travel")
        self.lock = threading.Lock()

    def __reduce__(self):
        raise TypeError("no")


def deeper(n):
    return deeper(n + 1)


def held_and_changed(array):
    """An array that is changed a little later, as a thread of a plugin would."""
    KEPT.append(array)
    other = array[:]
    threading.Timer(0.2, lambda: other.__setitem__(slice(None), -7.0)).start()
    return array


def in_buffer(light):
    VIEW[...] = np.resize(light, VIEW.shape)
    return VIEW[:, : light.shape[1], : light.shape[2]]


def raising(error):
    raise error


def set_and_return(change, value):
    change()
    return value


def masked(light):
    return np.ma.masked_less(light, 1e30)


def writes_into(light):
    light.flags.writeable = True
    light += 1
    return light


def mapped(light):
    import tempfile

    with tempfile.TemporaryFile() as file:
        found = np.memmap(file, dtype=light.dtype, mode="w+", shape=light.shape)
    found[...] = light
    return held_and_changed(found)


def chatters(light):
    print("from a plugin")
    os.write(1, b"from below a plugin\n")
    ctypes.CDLL(None).puts(b"from C")
    return light * 1


def overwrites(light):
    """As an extension in C does, which knows nothing of numpy's flag."""
    own = light.copy()
    ctypes.memset(light.ctypes.data, 0, light.nbytes)
    return own


def twice(light):
    """Also in a child, which goes on as if the run were its own."""
    return light if os.fork() else light + 1


def from_a_thread(light):
    thread = threading.Thread(target=os._exit, args=(0,))
    thread.start()
    thread.join()
    return light * 1


FAILS = {  # how -> (what it does, words of the message)
    "exits": (lambda light: sys.exit(0), "SystemExit: 0"),
    "is interrupted": (lambda light: raising(KeyboardInterrupt()), "KeyboardInterrupt"),
    "ends a generator": (lambda light: raising(GeneratorExit()), "GeneratorExit"),
    "finds no file": (lambda light: open("/etc/no/such/file"), "FileNotFoundError: No such file or directory: file"),
    "finds no room": (lambda light: raising(OSError(28, "No space left on device")), "No space left"),
    "wants memory": (lambda light: np.empty(1 << 60), "MemoryError"),
    "goes too deep": (lambda light: deeper(0), "RecursionError"),
    "cannot say why": (lambda light: raising(Unfriendly()), "Unfriendly: (its text is not available: SystemExit)"),
    "cannot travel": (lambda light: raising(Stuck(1, 2)), "Stuck: cannot travel"),
    "says a lot": (lambda light: raising(ArithmeticError("much " * 200_000)), "(1000000 characters)"),
    "says many lines": (lambda light: raising(ArithmeticError("line\n" * 5000 + "the end")), "more lines"),
    "sends escapes": (
        lambda light: raising(ArithmeticError("\x1b[2J\x00\x07red\r\u202egreen\x9b1m")),
        "ArithmeticError: [2Jredgreen1m",
    ),
    "gives objects": (lambda light: light.astype(object), "as object"),
    "gives a mask": (masked, "masked array"),
    "gives text": (lambda light: np.full(light.shape, "x"), "declares floats"),
    "gives ragged lists": (lambda light: [[[1.0], [1.0, 2.0]]], "not an array"),
    "gives complex numbers": (lambda light: light + 1j, "as complex"),
    "gives another shape": (lambda light: light[:, :-1], "with shape"),
    "gives NaN": (lambda light: np.where(light > 0, np.nan, 0), "NaN or infinite"),
    "gives too much": (lambda light: np.full(light.shape, 1e300), "NaN or infinite"),
    "gives huge numbers": (lambda light: np.full(light.shape, 10**400), "as object"),
    "writes into its input": (writes_into, "WRITEABLE"),
    "leaves": (lambda light: os._exit(7), "os._exit(7)"),
}
DIES = {
    "leaves below Python": (lambda light: ctypes.CDLL(None)._exit(7), "exit code 7"),
    "crashes": (lambda light: ctypes.string_at(0), "SIGSEGV"),
    "is killed": (lambda light: os.kill(os.getpid(), signal.SIGKILL), "SIGKILL"),
    "hangs": (lambda light: time.sleep(600), "no answer within 2 s"),
}
FINE = {
    "behaves": lambda light: light * 1,
    "chatters": chatters,
    "gives its input": lambda light: light,
    "gives a view of its input": lambda light: light[:, ::-1][:, ::-1],
    "holds on to its output": lambda light: held_and_changed(light * 1),
    "fills a buffer of its own": in_buffer,
    "gives a map of a file": mapped,
    "gives lists": lambda light: light.tolist(),
    "gives double precision": lambda light: light.astype(np.float64),
    "gives it turned over": lambda light: np.asfortranarray(light),
    "gives big-endian numbers": lambda light: light.astype(">f4"),
    "goes elsewhere": lambda light: set_and_return(lambda: os.chdir("/"), light * 1),
    "raises on zero": lambda light: set_and_return(lambda: np.seterr(all="raise"), light * 1),
    "is strict": lambda light: set_and_return(lambda: warnings.simplefilter("error"), light * 1),
    "writes below numpy": overwrites,
    "comes back twice": twice,
    "leaves from a thread": from_a_thread,
    "hides its files": lambda light: set_and_return(lambda: os.umask(0o777), light * 1),
    "goes deeper": lambda light: set_and_return(lambda: sys.setrecursionlimit(123_456), light * 1),
    "leaves a thread": lambda light: set_and_return(
        lambda: threading.Thread(target=time.sleep, args=(600,)).start(), light * 1
    ),
}
WHOLE = {
    "gives nothing": None,
    "gives an array": np.ones(3),
    "gives too little": {},
    "gives too many": {"irradiance": 1.0, 7: 2},
}


@dataclass(frozen=True, kw_only=True)
class Lamp(Source):
    """A ramp of light that needs no tables."""

    writes: ClassVar = {"irradiance": LIGHT}

    def describe(self):
        return Facts(), {"irradiance": Grid.of({"wavelength": Bands((400.0, 700.0)), "y": Line(8), "x": Line(9)})}

    def run(self, out_x):
        return {"irradiance": np.broadcast_to(1.0 + out_x, (1, 8, 9))}


@dataclass(frozen=True, kw_only=True)
class Naughty(Stage):
    """Light unchanged, or not."""

    reads: ClassVar = {"irradiance": LIGHT}
    writes: ClassVar = {"irradiance": LIGHT}
    how: str = param("behaves", doc="in which way it misbehaves")

    def run(self, irradiance):
        if self.how in WHOLE:
            return WHOLE[self.how]
        does = FINE.get(self.how) or {**FAILS, **DIES}[self.how][0]
        return {"irradiance": does(irradiance)}


@dataclass(frozen=True, kw_only=True)
class Witness(Stage):
    """Twice the light, through a division by zero and a warning that are nobody's business."""

    reads: ClassVar = {"irradiance": LIGHT}
    writes: ClassVar = {"seen_light": LIGHT}

    def run(self, irradiance):
        with np.errstate(divide="ignore"):
            np.ones(1) / 0
        warnings.warn("this is nobody's business", stacklevel=1)
        return {"seen_light": irradiance * 2}


@hookimpl
def etendue_stages():
    return {"lamp": Lamp, "naughty": Naughty, "witness": Witness}
