"""Tasks of the tests of campaigns; worker processes import this module."""

import os
import signal
import time
from pathlib import Path

import numpy as np


def square(number, log=None):
    """Square a number; every call leaves a line of its own."""
    if log is not None:
        with Path(log).open("a") as file:
            file.write(f"{number}\n")
    return {"number": number, "square": number**2, "pid": os.getpid()}


def spread(seed):
    """Arrays beside a figure."""
    drawn = np.random.default_rng(seed).standard_normal(1000)
    return {"std": drawn.std(), "drawn": drawn, "pair": (1, float("nan"))}


def fail(number):
    """Fail on 3."""
    if number == 3:
        raise ValueError("three is not wanted")
    return {"number": number}


def leave(number):
    """End the process by way of sys.exit."""
    raise SystemExit(number)


def shout(number):
    """Print, which must not get among the answers."""
    print("not an answer", flush=True)
    return {"number": number}


def opaque():
    """Return what cannot be written down."""
    return {"nested": {"array": np.zeros(2)}}


def die_once(number, marks):
    """Kill the own process the first time that it runs with 2."""
    mark = Path(marks) / f"mark-{number}"
    if number == 2 and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return square(number, Path(marks) / "log")


def always_die(number):
    """Kill the own process."""
    if number == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    return {"number": number}


def slow(number, marks, seconds=0.3):
    """Take a while; leave a line at the start and one at the end."""
    directory = Path(marks)
    with (directory / "began").open("a") as file:
        file.write(f"{number} {os.getpid()}\n")
    time.sleep(seconds)
    return square(number, directory / "log")
