"""What no effect of the library explains, in words."""

from collections.abc import Sequence

from orbitfb.diagnose.hypotheses.free_course import FreeCourse
from orbitfb.diagnose.impact.named import Named
from orbitfb.diagnose.result.blocks import Unknown
from orbitfb.diagnose.result.headline import RING
from orbitfb.diagnose.verdict.proved import Untold
from orbitfb.diagnose.verdict.state import Judged
from orbitfb.records.finding import listed

_NAMED = 4
"""Places that a sentence names."""

_WHERE = 12
"""Devices at which a remainder is said to sit, at most."""


def unknown_of(
    verdict: Judged, causes: Sequence[Named], untold: Sequence[Untold] = ()
) -> Unknown | None:
    """Tell what is known of what no effect explains.

    Args:
        verdict: On the record without what the screen proves.
        causes: Found in it.
        untold: What the screen proves, and has no name.
    """
    proved = " ".join(one.text for one in untold)
    if verdict.state not in ("unknown", "named_plus_remainder"):
        if not untold or verdict.state == "ambiguous":
            return None
        return Unknown(places=tuple(name for one in untold for name in one.devices), text=proved)
    told = sum(one.evidence for one in causes)
    places = tuple(dict.fromkeys(name for one in verdict.left[:_WHERE] for name in one.names))
    text, what = "", "The gap" if verdict.state == "unknown" else "The rest"
    if verdict.improper is not None:
        poor = verdict.improper
        places = poor.names[:_WHERE]
        where = f" at {listed(poor.names[:_NAMED])}" if poor.names else ""
        text = (
            f"{what}{where} looks most like {poor.kind.title}, but {poor.lacks}: a simpler law "
            "does the same, which is not in the library or was left out."
        )
    elif verdict.rest is not None:
        places = verdict.rest.names[:_WHERE]
        text = (
            f"The rest looks most like {verdict.rest.kind.title}. If so many effects seem to act "
            "at once, one effect that is not in the library is more likely."
        )
    elif verdict.left:
        text = _of_free(verdict.left[0], what)
    elif verdict.shared:
        ring = verdict.shared == (RING,)
        places = () if ring else verdict.shared[:_WHERE]
        text = (
            f"Two effects {'of the whole ring' if ring else 'at the very same devices'} would be a "
            "coincidence. One effect that looks like both, and is not in the library, is more "
            "likely."
        )
    elif verdict.state == "named_plus_remainder":
        text = "One effect that is not in the library may make all of it, rest and causes."
    return Unknown(
        places=places,
        text=" ".join(filter(None, (text, proved))),
        nearest=causes[0].kind.id if causes else "",
        nearest_nats=causes[0].evidence if causes else None,
        explained=verdict.explained if told else 0.0,
    )


def _of_free(first: FreeCourse, what: str) -> str:
    """Say what a free course found.

    Args:
        first: The most telling one.
        what: The gap, or the rest.
    """
    names = listed(first.names[:_NAMED])
    at = f" at {names}" if first.names else ""
    if first.target == "noise":
        where = f"BPM {first.names[0]}" if first.names else "all BPMs"
        return (
            f"The noise of {where} grows or shrinks with how far or how fast the beam moves there, "
            "by a law that is not in the library."
        )
    if first.target == "shared":
        return f"The BPMs {names} have noise in common, in a way that is not in the library."
    if first.target == "varying":
        return (
            f"What was named{at} is not the same all the time: it comes and goes, or it is "
            "another law."
        )
    if first.target == "spectrum":
        return f"What was named{at} does not have the spectrum of its law: it is another one."
    if first.target == "source":
        return (
            f"{what} is like kicks at {first.names[0]}, whose course in time is not in the library."
        )
    device = {"bpm": "BPM", "corrector": "corrector"}[first.target]
    where = f"all {device}s alike"
    if first.names:
        where = f"the {device}s of {first.cell}" if first.cell else f"{device} {first.names[0]}"
    return f"{what} follows the motion of {where}, by a law that is not in the library."
