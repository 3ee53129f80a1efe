"""The command that tells what happened at a trip."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from orbitfb.cli.options import AsJson, ConfigFile, DataDirectory, configure

if TYPE_CHECKING:
    from collections.abc import Iterable


def postmortem(
    file: Annotated[
        Path | None,
        typer.Argument(
            help="Post-mortem: a file, or its name in the data directory; `last` is the newest. "
            "Without a name, those of the data directory are listed."
        ),
    ] = None,
    config_file: ConfigFile = None,
    data: DataDirectory = None,
    out: Annotated[
        Path | None,
        typer.Option(
            help="File to draw: .html (the whole page), .png or .svg [FILE.html in the current "
            "directory]."
        ),
    ] = None,
    last: Annotated[
        float, typer.Option(min=0.0, help="Show what changed in this time before the trip [s].")
    ] = 10.0,
    as_json: AsJson = False,
) -> None:
    """Show what happened at a trip, or list the trips on disk."""
    directory = configure(config_file, data_directory=data).data_directory / "postmortem"
    if file is None:
        _list(directory, as_json)
        return
    from orbitfb.cli.text import as_json as json_of
    from orbitfb.postmortem.page import write_page
    from orbitfb.postmortem.reading import read_postmortem
    from orbitfb.postmortem.story import lines, story_of, values

    story = story_of(read_postmortem(_chosen(file, directory)), last)
    target = out or Path(f"{story.its.path.stem}.html")
    write_page(story, target)
    if as_json:
        print(json_of(values(story) | {"picture": str(target)}))
    else:
        _say(lines(story))
        print(f"picture: {target}")


def _chosen(file: Path, directory: Path) -> Path:
    """Find the file that is meant."""
    from orbitfb.core.errors import RecordError
    from orbitfb.postmortem.shelf import stored

    if file.exists():
        return file
    found = stored(directory)
    if str(file) == "last":
        if not found:
            raise RecordError(f"no post-mortem is in {directory}: no trip was kept yet")
        return found[-1]
    named = directory / file.name
    return named if named in found else file


def _list(directory: Path, as_json: bool) -> None:
    from orbitfb.cli.text import as_json as json_of
    from orbitfb.core.errors import RecordError
    from orbitfb.postmortem.opening import number_of, read_about, text_of
    from orbitfb.postmortem.shelf import stored
    from orbitfb.postmortem.story import time_text

    entries: list[dict[str, Any]] = []
    for path in stored(directory):
        entry: dict[str, Any] = {"file": str(path), "size": path.stat().st_size}
        try:
            about = read_about(path)
        except RecordError as error:
            entries.append(entry | {"problem": str(error)})
            continue
        wall = number_of(about, "time")
        entries.append(
            entry
            | {"time": wall if wall == wall else None}
            | {word: text_of(about, word) for word in ("trigger", "state", "reason")}
        )
    if as_json:
        print(json_of({"postmortems": entries}))
        return
    if not entries:
        print(f"no post-mortems in {directory}: the loop has not tripped")
    for entry in entries:
        when = entry.get("time")
        _say(
            [
                f"{Path(entry['file']).name}  {time_text(when) if when else '-'}  "
                f"{entry.get('state', ''):<8} {entry.get('reason') or entry.get('problem', '')}"
            ]
        )


def _say(told: "Iterable[str]") -> None:
    """Print lines; what a file brought must move no cursor."""
    for line in told:
        print("".join(sign for sign in line if sign.isprintable()))
