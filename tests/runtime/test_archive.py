"""`.npz` files of plain arrays, and files that are written whole or not at all."""

import errno
import os
import zipfile
from pathlib import Path

import numpy as np
import pytest

from maesn.runtime.archive import DEEPEST, npz, parse_json, read_arrays, write_whole

ARRAYS = {
    "goal": np.arange(6.0).reshape(3, 2),
    "block": np.int32([1, 2]),
    "name": np.array("a text"),
}


def test_arrays_come_back_with_their_types(tmp_path: Path) -> None:
    write_whole(tmp_path / "file.npz", npz(ARRAYS))
    found = read_arrays(tmp_path / "file.npz")
    assert list(found) == list(ARRAYS)
    for name, array in ARRAYS.items():
        assert found[name].dtype == array.dtype
        np.testing.assert_array_equal(found[name], array)


def test_other_files_are_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "single.npy", np.zeros(2))
    np.savez(tmp_path / "objects.npz", goal=np.array([{"a": 1}], dtype=object))
    (tmp_path / "text.npz").write_text("goal: 1, 2")
    (tmp_path / "empty.npz").write_bytes(b"")
    with zipfile.ZipFile(tmp_path / "other.npz", "w") as members:
        members.writestr("goal", "1, 2")
    names = [path.name for path in tmp_path.iterdir()]
    assert len(names) == 5
    for name in names:
        with pytest.raises(ValueError, match=r"no \.npz file of plain arrays, or damaged"):
            read_arrays(tmp_path / name)
    with pytest.raises(FileNotFoundError):
        read_arrays(tmp_path / "nothing.npz")


def with_header(path: Path, header: str, compression: int = zipfile.ZIP_STORED) -> None:
    """Write an array whose header says what it likes; the checksum is right."""
    text = header.encode() + b" " * 64 + b"\n"
    start = b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little")
    with zipfile.ZipFile(path, "w", compression) as members:
        members.writestr("goal.npy", start + text + np.zeros((3, 2)).tobytes())


def with_number(path: Path, offset: int, number: bytes) -> None:
    """Change a number in the file's table of contents."""
    content = bytearray(path.read_bytes())
    start = content.rindex(b"PK\x01\x02") + offset
    content[start : start + len(number)] = number
    path.write_bytes(content)


HEADER = "{'descr': '<f8', 'fortran_order': False, 'shape': (3, 2)}"


@pytest.mark.parametrize(
    "changes",
    [
        ("(3, 2)", "(10000000000000000, 2)"),  # 160 petabytes
        ("(3, 2)", "(300, 2)"),
        ("(3, 2)", "(-1, 2)"),
        ("(3, 2)", f"({'9' * 30},)"),
        ("(3, 2)", "(4294967296, 4294967296)"),
        ("'<f8'", "'<U9999999999'"),
        ("'<f8'", "'|O'"),
        ("'<f8'", "['a', 'b']"),
        ("'<f8'", "[('a',)]"),
        ("False", "3"),
        (HEADER, "(" * 3000),
        (HEADER, "[" * 90 + "]" * 90),
        (HEADER, "{[]: 1}"),
        ("}", ""),
        ("'descr", '"descr'),
    ],
)
def test_headers_that_make_no_sense_are_refused(tmp_path: Path, changes: tuple[str, str]) -> None:
    path = tmp_path / "file.npz"
    with_header(path, HEADER)
    np.testing.assert_array_equal(read_arrays(path)["goal"], np.zeros((3, 2)))
    with_header(path, HEADER.replace(*changes))
    with pytest.raises(ValueError, match="or damaged"):
        read_arrays(path)


@pytest.mark.parametrize("compression", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA, 99])
def test_only_numpys_own_compression_is_read(tmp_path: Path, compression: int) -> None:
    path = tmp_path / "file.npz"
    with_header(path, HEADER, zipfile.ZIP_DEFLATED)
    assert read_arrays(path)["goal"].shape == (3, 2)
    with_number(path, 10, compression.to_bytes(2, "little"))
    with pytest.raises(ValueError, match="compressed in another way"):
        read_arrays(path)


def test_a_small_file_that_states_much_is_refused_unread(tmp_path: Path) -> None:
    path = tmp_path / "file.npz"
    with_header(path, HEADER, zipfile.ZIP_DEFLATED)
    with_number(path, 24, (2**32 - 2).to_bytes(4, "little"))
    with pytest.raises(ValueError, match=r"it states 4,295 MB of arrays, at most 1,074"):
        read_arrays(path)


def test_pipes_and_devices_are_refused(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", Path("/dev/zero")):
        with pytest.raises(ValueError, match="it is a pipe or a device"):
            read_arrays(path)


def test_objects_are_refused() -> None:
    with pytest.raises(ValueError, match="Object arrays"):
        npz({"goal": np.array([{}], dtype=object)})


def test_a_failed_write_keeps_the_file_that_was_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_whole(tmp_path / "file", b"old")

    def full(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patched:
        patched.setattr(os, "fsync", full)
        with pytest.raises(OSError, match="No space left"):
            write_whole(tmp_path / "file", b"new")
    assert (tmp_path / "file").read_bytes() == b"old"
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
    write_whole(tmp_path / "file", b"new")
    assert (tmp_path / "file").read_bytes() == b"new"


@pytest.mark.parametrize(("opening", "closing"), [("[", "]"), ('{"a":', "}")])
def test_a_text_that_is_nested_deeply_is_refused_before_anything_walks_through_it(
    opening: str, closing: str
) -> None:
    def text(levels: int) -> str:
        return opening * levels + "0" + closing * levels

    assert parse_json(text(DEEPEST - 1)) is not None
    for levels in (DEEPEST + 1, 900, 10**6):
        with pytest.raises(ValueError, match="nested too deeply"):
            parse_json(text(levels))
