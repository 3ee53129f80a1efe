"""Write the archive as Parquet, one row per tick, for pandas, polars, DuckDB or Spark.

One column per column of the archive; vectors are lists of a fixed length whose names stand in the
metadata of the column. A segment at a time is in memory. Needs the extra `parquet`.
"""

import contextlib
import json
import os
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow as pa
from pyarrow import parquet

from orbitfb.core.errors import ExchangeError
from orbitfb.core.signals import Channels
from orbitfb.exchange.naming import plain_labels
from orbitfb.history.columns import AUXILIARY, STATES, UNITS
from orbitfb.history.reader import LARGEST_ARCHIVE, segment_paths
from orbitfb.history.verify import CorruptSegmentError, SegmentContent, read_segment

RUN = "run"
_TEXTS = ("state", "policy_id", RUN)
_BPMS = ("orbit", "valid", "reference")
_CORRECTORS = ("setpoints", "requested", "dither", "applied", "readback")


def export_archive(path: Path, out: Path, skip_corrupt: bool = False) -> dict[str, Any]:
    """Write all complete rows of an archive.

    Args:
        path: A segment, or a directory of them.
        out: The file.
        skip_corrupt: Leave out segments that cannot be read.

    Returns:
        What was written.

    Raises:
        ExchangeError: It cannot be written.
        ArchiveError: There is nothing to read, a segment is corrupt or of another ring.
    """
    if out.suffix.lower() != ".parquet":
        raise ExchangeError(f"--out {out}: let its name end in .parquet")
    segments = segment_paths(path)
    slow = sorted({name for segment in segments for name in _slow_names(segment)})
    unfinished = out.parent / f".unfinished-{uuid.uuid4().hex}"
    rows, skipped, first = 0, [], None
    writer: parquet.ParquetWriter | None = None
    try:
        with contextlib.ExitStack() as stack:
            for content in _contents(segments, skip_corrupt, skipped):
                if first is None or writer is None:
                    first = content.channels
                    schema = _schema(first, slow)
                    writer = stack.enter_context(
                        parquet.ParquetWriter(unfinished, schema, compression="zstd")
                    )
                if content.channels != first:
                    raise ExchangeError(
                        f"{content.path} is of another ring than the segments before it; export "
                        "each ring by itself"
                    )
                writer.write_table(_table(content, writer.schema, slow))
                rows += content.rows
        if writer is None:
            raise ExchangeError(f"{path} holds no readable row; run the loop to record some")
        with unfinished.open("rb") as file:
            os.fsync(file.fileno())  # whole on disk before it takes the name
        unfinished.replace(out)
    except OSError as error:
        raise ExchangeError(
            f"{out} cannot be written ({error.strerror or error}); make room or name another place"
        ) from error
    finally:
        unfinished.unlink(missing_ok=True)
    return {
        "file": str(out),
        "rows": rows,
        "segments": len(segments) - len(skipped),
        "skipped": "; ".join(skipped),
        "bytes": out.stat().st_size,
    }


def _contents(
    segments: list[Path], skip_corrupt: bool, skipped: list[str]
) -> Iterator[SegmentContent]:
    for segment in segments:
        try:
            content = read_segment(segment, LARGEST_ARCHIVE)
        except FileNotFoundError:
            continue  # retention took it away since it was listed
        except CorruptSegmentError:
            if not skip_corrupt:
                raise
            skipped.append(segment.name)
            continue
        if content.rows:
            yield content


def _slow_names(segment: Path) -> tuple[str, ...]:
    """Name the slow channels of a segment; none of one that cannot be read."""
    try:
        with h5py.File(segment, "r") as file:
            group = file.get(AUXILIARY[:-1])
            return tuple(map(str, group)) if isinstance(group, h5py.Group) else ()
    except (OSError, RuntimeError, KeyError, ValueError):
        return ()


def _schema(channels: Channels, slow: list[str]) -> pa.Schema:
    bpms = plain_labels(channels.bpms, channels.bpm_planes)
    correctors = plain_labels(channels.correctors, channels.corrector_planes)
    fields: list[pa.Field] = []
    for name, unit in {RUN: "", **UNITS, **{AUXILIARY + each: "SI" for each in slow}}.items():
        names = bpms if name in _BPMS else correctors if name in _CORRECTORS else ()
        about = {"unit": unit} | ({"names": json.dumps(names)} if names else {})
        fields.append(pa.field(name, _type(name, len(names)), metadata=about))
    return pa.schema(fields, metadata={"planes": channels.planes, "schema_version": "1"})


def _type(name: str, length: int) -> pa.DataType:
    if name in _TEXTS:
        return pa.dictionary(pa.int32(), pa.string())
    if name in ("tick", "missed"):
        return pa.int64()
    inner = pa.bool_() if name == "valid" else pa.float64()
    return pa.list_(inner, length) if length else inner


def _table(content: SegmentContent, schema: pa.Schema, slow: list[str]) -> pa.Table:
    missing = np.full(content.rows, np.nan)
    columns: list[Any] = []
    for field in schema:
        name = field.name
        if name == RUN:
            values: Any = [content.run] * content.rows
        elif name == "state":
            values = [str(STATES[number]) for number in content.columns[name]]
        elif name == "policy_id":
            values = [text.decode("utf-8", "replace") for text in content.columns[name].tolist()]
        else:
            values = content.columns.get(name, missing)
        columns.append(_array(values, field.type))
    return pa.Table.from_arrays(columns, schema=schema)


def _array(values: Any, kind: pa.DataType) -> Any:
    if pa.types.is_dictionary(kind):
        return pa.array(values, pa.string()).dictionary_encode()
    if pa.types.is_fixed_size_list(kind):
        flat = pa.array(np.ascontiguousarray(values).reshape(-1), kind.value_type)
        return pa.FixedSizeListArray.from_arrays(flat, kind.list_size)
    return pa.array(values, kind)
