"""Files as somebody writes them who means harm: wrong content under a right checksum."""

import io
import json
import os
import random
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import safetensors
import safetensors.numpy

from maesn.runs import checkpoint
from maesn.runs.checkpoint import CHECKSUM
from maesn.serialization import digest_of_document

DEEP = 10**5


class Trap:
    """Makes a directory if somebody unpickles it."""

    def __init__(self, path: Path) -> None:
        self.path = str(path)

    def __reduce__(self) -> Any:
        return os.mkdir, (self.path,)


def forged(stream: random.Random, path: Path, canary: Path) -> bytes:
    """Return what somebody may put in the place of a file; executing it makes the canary."""
    forge = {
        ".json": _json,
        ".jsonl": _json_lines,
        ".safetensors": _safetensors,
        ".npz": _npz,
        ".csv": _csv,
    }[path.suffix]
    return forge(stream, path.read_bytes(), canary)


def odd_value(stream: random.Random, canary: Path) -> Any:
    """What no setting is."""
    nested: Any = 0
    for _ in range(300):
        nested = [nested]
    return stream.choice(
        [
            *(None, True, -1, 0, 1, 10**11, 10**30, 1e308, -0.5, float("nan"), float("inf")),
            *("", "x" * 10**5, "\0", "os:mkdir", "..:x", "../../x", str(canary), [], {}, nested),
            *([1, "2"], {"type": "os.mkdir", "path": str(canary)}, {"__reduce__": str(canary)}),
        ]
    )


def altered(stream: random.Random, document: Any, canary: Path) -> Any:
    """Return a JSON document with one value, name or item that is another one."""
    if isinstance(document, dict) and document and stream.random() < 0.9:
        changed, name = dict(document), stream.choice(list(document))
        if stream.random() < 0.1:
            del changed[name]
        elif stream.random() < 0.1:
            changed[f"{name}x"] = changed.pop(name)
        else:
            changed[name] = altered(stream, document[name], canary)
        return changed
    if isinstance(document, list) and document and stream.random() < 0.8:
        index = stream.randrange(len(document))
        return [altered(stream, x, canary) if n == index else x for n, x in enumerate(document)]
    return odd_value(stream, canary)


def _json(stream: random.Random, content: bytes, canary: Path) -> bytes:
    if stream.random() < 0.1:
        return stream.choice(
            ["[" * DEEP, '{"a":' * DEEP, "null", "[]", '{"schema": [[2]]}']
        ).encode()
    document = json.loads(content)
    document.pop("digest", None)
    document = altered(stream, document, canary)
    if isinstance(document, dict) and "schema" in document:
        document["digest"] = digest_of_document(document)
    return json.dumps(document).encode()


def _json_lines(stream: random.Random, content: bytes, canary: Path) -> bytes:
    lines = content.splitlines(keepends=True)
    number = stream.randrange(len(lines))
    lines[number] = _json(stream, lines[number], canary) + b"\n"
    return b"".join(lines)


def _safetensors(stream: random.Random, content: bytes, canary: Path) -> bytes:
    if stream.random() < 0.2:
        return _odd_header(stream, content)
    values = safetensors.numpy.load(content)
    size = int.from_bytes(content[:8], "little")
    metadata = json.loads(content[8 : 8 + size])["__metadata__"]
    metadata.pop(CHECKSUM)
    if stream.random() < 0.4:
        # The count of steps is believed where the checksum is right.
        name = stream.choice([*sorted(metadata.keys() - {"environment_steps"}), "more"])
        odd = ["", "abc", "-3", "9" * 11, "9" * 30, "1e5", "٣", "0x10", "[" * 1000, str(canary)]
        metadata[name] = stream.choice(odd)
    else:
        name = stream.choice([*values, "more"])
        values[name] = _odd_array(stream, values.get(name, np.zeros(3, np.float32)))
    metadata[CHECKSUM] = checkpoint._checksum(values, metadata)
    return safetensors.numpy.save(values, metadata=metadata)


def _odd_header(stream: random.Random, content: bytes) -> bytes:
    size = int.from_bytes(content[:8], "little")
    header, body = json.loads(content[8 : 8 + size]), content[8 + size :]
    name = stream.choice([name for name in header if name != "__metadata__"])
    header[name] |= stream.choice(
        [{"shape": [10**12]}, {"data_offsets": [0, 2**62]}, {"dtype": "F4096"}, {"shape": [-1]}]
    )
    text = stream.choice([json.dumps(header), "[" * DEEP, "{}"]).encode()
    length = stream.choice([len(text), 2**62, 0])
    return length.to_bytes(8, "little") + text + body


def _odd_array(stream: random.Random, array: np.ndarray) -> np.ndarray:
    filled = [np.full(array.shape, x) for x in (np.nan, np.inf, -1e30, 1e300, 0.0, -1)]
    shaped = [array[None], array.ravel(), np.zeros((0, *array.shape[1:])), np.zeros(())]
    typed = [array.astype(kind) for kind in (np.float16, np.int64, np.bool_, np.uint8)]
    with np.errstate(all="ignore"):
        return stream.choice([*filled, *shaped, *typed])


def _npz(stream: random.Random, content: bytes, canary: Path) -> bytes:
    with np.load(io.BytesIO(content)) as found:
        arrays: dict[str, Any] = dict(found)
    name, more = stream.choice(list(arrays)), io.BytesIO()
    how = stream.choice(["pickle", "raw pickle", "array", "missing", "huge", "method", "metadata"])
    if how == "metadata" and "metadata" in arrays:
        document = altered(stream, json.loads(str(arrays["metadata"])), canary)
        arrays["metadata"] = np.array(json.dumps(document))
    elif how == "missing":
        del arrays[name]
    elif how == "array" and arrays[name].dtype.kind in "fiu":
        arrays[name] = _odd_array(stream, arrays[name])
    elif how == "method":
        return _zipped(arrays, stream.choice([zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA]))
    elif how == "huge":
        return _zipped(arrays, zipfile.ZIP_DEFLATED, {name: _claiming(stream)})
    elif how == "raw pickle":
        pickled = io.BytesIO()
        np.save(pickled, np.array([Trap(canary)], dtype=object), allow_pickle=True)
        raw = pickled.getvalue()
        return _zipped(
            arrays, zipfile.ZIP_STORED, {name: raw[128:] if stream.random() < 0.5 else raw}
        )
    else:
        arrays[name] = np.array([Trap(canary)], dtype=object)
    np.savez(more, **arrays)
    return more.getvalue()


def _claiming(stream: random.Random) -> bytes:
    shape = stream.choice(["(1000000000000,)", "(-1,)", "(2, 2", "(1e3,)", "(" * 10**4, "()" * 100])
    header = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    return b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header + bytes(64)


def _zipped(arrays: dict[str, Any], method: int, instead: dict[str, bytes] | None = None) -> bytes:
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", method) as members:
        for name, array in arrays.items():
            written = io.BytesIO()
            np.save(written, array)
            members.writestr(f"{name}.npy", (instead or {}).get(name, written.getvalue()))
    return content.getvalue()


def _csv(stream: random.Random, content: bytes, _: Path) -> bytes:
    rows = [line.split(",") for line in content.decode().splitlines()]
    row = stream.choice(rows)
    column = stream.randrange(len(row))
    odd = ["", "nan", "inf", "1e400", "-1", "x" * 200_000, '"', "\0", "1e300", "9" * 5000, "\ufeff"]
    row[column] = stream.choice(odd)
    stream.choice([lambda: None, row.pop, lambda: rows.append(row), rows.pop])()
    return "\n".join(map(",".join, rows)).encode()
