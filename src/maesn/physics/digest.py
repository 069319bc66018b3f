"""A digest of a model, by which a changed one is noticed."""

import hashlib
import os
from collections.abc import Iterable
from xml.etree import ElementTree

from maesn.physics.loading import find_model

# Attributes of MJCF's `compiler` that say where files are looked for.
_FOLDERS = ("meshdir", "texturedir", "assetdir")


def model_digest(model: str | os.PathLike[str]) -> str:
    """Return a hexadecimal hash of a model's XML and of all files that it names.

    Comments, indentation and the order of attributes do not count.

    Args:
        model: as for `load_model`.

    Raises:
        FileNotFoundError: there is neither such a model nor such a file.
    """
    found = find_model(model)
    if isinstance(found, str):
        return _joined([_canonical(found)])
    # Every file that is met may name others: parts of the model, meshes, textures.
    met, folders, contents = [found], {""}, []
    for file in met:  # grows meanwhile
        content = file.read_bytes()
        if file.suffix.lower() in (".xml", ".mjcf", ".urdf"):
            content = _canonical(content.decode())
            named = _named_files(content, folders)
            paths = [found.parent / folder / name for name in named for folder in sorted(folders)]
            met += [path for path in paths if path.is_file() and path not in met]
        contents.append(content)
    return _joined(contents)


def _canonical(xml: str) -> bytes:
    try:
        return ElementTree.canonicalize(xml, strip_text=True).encode()
    except ElementTree.ParseError:  # MuJoCo's own reader may be less strict
        return xml.encode()


def _named_files(xml: bytes, folders: set[str]) -> list[str]:
    """Return the files that elements name, and add to the folders that they may be in."""
    try:
        elements = list(ElementTree.fromstring(xml).iter())
    except ElementTree.ParseError:
        return []
    for element in elements:
        if element.tag == "compiler":
            folders |= {element.get(name, "") for name in _FOLDERS}
    return [name for name in (element.get("file") for element in elements) if name]


def _joined(contents: Iterable[bytes]) -> str:
    sha = hashlib.sha256()
    for content in contents:
        sha.update(hashlib.sha256(content).digest())
    return sha.hexdigest()[:16]
