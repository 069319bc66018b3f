"""A digest of a MuJoCo model, to notice when the model has changed."""

import hashlib
import os
from collections.abc import Iterable
from xml.etree import ElementTree

from maesn.physics.loading import find_model

# Attributes of MJCF's element `compiler` that name folders of files.
_FOLDERS = ("meshdir", "texturedir", "assetdir")


def model_digest(model: str | os.PathLike[str]) -> str:
    """Return a hexadecimal hash of a model's XML and of all files that it refers to.

    Comments, indentation and the order of attributes do not count. The model is named as for
    `load_model`; FileNotFoundError says that it or a file of it is missing.
    """
    found = find_model(model)
    if isinstance(found, str):
        return _digest([_canonical(found)])
    # A file may refer to others: parts of the model, meshes, textures. They join the list.
    files, folders, contents = [found], {""}, []
    for file in files:
        content = file.read_bytes()
        if file.suffix.lower() in (".xml", ".mjcf", ".urdf"):
            content = _canonical(content.decode())
            names, more_folders = _references(content)
            folders |= more_folders
            paths = [found.parent / folder / name for name in names for folder in sorted(folders)]
            files += [path for path in paths if path.is_file() and path not in files]
        contents.append(content)
    return _digest(contents)


def _canonical(xml: str) -> bytes:
    try:
        return ElementTree.canonicalize(xml, strip_text=True).encode()
    except ElementTree.ParseError:  # MuJoCo's own reader may be less strict
        return xml.encode()


def _references(xml: bytes) -> tuple[list[str], set[str]]:
    """Return the files that an XML file refers to, and the folders that they may lie in."""
    try:
        elements = list(ElementTree.fromstring(xml).iter())
    except ElementTree.ParseError:
        return [], set()
    files = [name for name in (element.get("file") for element in elements) if name]
    compilers = [element for element in elements if element.tag == "compiler"]
    return files, {element.get(name, "") for element in compilers for name in _FOLDERS}


def _digest(contents: Iterable[bytes]) -> str:
    sha = hashlib.sha256()
    for content in contents:
        sha.update(hashlib.sha256(content).digest())
    return sha.hexdigest()[:16]
