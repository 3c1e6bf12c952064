"""Colours and pictures of mesh files: one of them for the whole mesh, whatever way the file stores them."""

from __future__ import annotations

import io
import logging
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from multicam.files import write_bytes

_LOG = logging.getLogger(__name__)

UNCOLORED = 160
"""Grey of parts without a colour in a file whose other parts have one."""


@dataclass(frozen=True, eq=False)
class Appearance:
    """How a mesh looks: colours of its vertices, or a picture laid over it, or neither.

    Attributes:
        colors: (V, 3) uint8 RGB, or None.
        uv: (V, 2), (0, 0) the lower left corner of the picture; None without a picture.
        texture: file of the picture, or None.
    """

    colors: NDArray[np.uint8] | None = None
    uv: NDArray[np.float64] | None = None
    texture: Path | None = None


def join_parts(
    parts: Sequence[Any], path: Path, pictures: Path | None
) -> tuple[NDArray[np.float64], NDArray[np.int64], Appearance]:
    """Vertices, faces and appearance of the trimesh objects that one file holds.

    A mesh has one picture: several are packed into one. Flat colours of faces and materials become colours of
    vertices, for which vertices are split where such colours meet.

    Args:
        parts: trimesh.Trimesh, unprocessed.
        path: file they come from.
        pictures: folder that receives a picture which is no file of its own (inside a GLB, or packed), under the
            name of the mesh; without it such a picture becomes colours of vertices.
    """
    _warn_of_missing_files(path)
    named = _named_picture(path)
    images = [_image_of(part, named) for part in parts]
    if not any(image is not None for image in images):
        return _with_colors(parts)
    import trimesh

    # Materials of an OBJ may share a file, parts of a GLB an image.
    alone = None not in images and len({image.info.get("file_path", id(image)) for image in images}) == 1
    joined: Any = parts[0] if len(parts) == 1 else trimesh.util.concatenate(list(parts))
    packed = joined.visual.material
    image = images[0] if alone else getattr(packed, "image", None) or packed.baseColorTexture
    vertices, faces = np.asarray(joined.vertices, dtype=np.float64), np.asarray(joined.faces, dtype=np.int64)
    uv = np.concatenate([np.asarray(p.visual.uv) for p in parts]) if alone else np.asarray(joined.visual.uv)
    file = named or _file_of(image, path) if alone else None
    if file is None and pictures is None:
        from trimesh.visual.color import uv_to_color

        colors: Any = uv_to_color(uv, image.convert("RGB"))
        return vertices, faces, Appearance(colors=np.asarray(colors, dtype=np.uint8)[:, :3])
    if file is None:
        assert pictures is not None
        file = pictures / f"{path.stem}.png"
        write_bytes(file, _as_png(image))
    return vertices, faces, Appearance(uv=uv.astype(np.float64), texture=file)


def png_bytes(path: Path) -> bytes:
    """A picture file as PNG; one that is PNG already is taken byte by byte."""
    data = path.read_bytes()
    if data.startswith(b"\x89PNG"):
        return data
    from PIL import Image

    return _as_png(Image.open(io.BytesIO(data)))


def _as_png(image: Any) -> bytes:
    out = io.BytesIO()
    image.convert("RGB").save(out, format="PNG")
    return out.getvalue()


def _named_picture(path: Path) -> Path | None:
    """The picture that a PLY file names (`comment TextureFile NAME`) and that is there, or None."""
    name = _texture_name(path)
    return path.parent / name if name and (path.parent / name).is_file() else None


def _texture_name(path: Path) -> str | None:
    if path.suffix.lower() != ".ply":
        return None
    with open(path, "rb") as stream:
        header = stream.read(1 << 16).partition(b"end_header")[0]
    found = re.search(rb"^comment TextureFile[ \t]+([^\r\n]+?)[ \t]*\r?$", header, re.MULTILINE)
    return found.group(1).decode(errors="replace") if found else None


def _image_of(part: Any, named: Path | None) -> Any:
    """The decoded picture of a part with texture coordinates, or None; an unreadable one raises OSError."""
    if part.visual.kind != "texture" or part.visual.uv is None:
        return None
    if named is not None:
        from PIL import Image

        image: Any = Image.open(named)
    else:
        material = part.visual.material
        image = getattr(material, "baseColorTexture", None)
        # trimesh makes up a picture where an OBJ file has none; a real one knows its file.
        if image is None and "file_path" in getattr(getattr(material, "image", None), "info", {}):
            image = material.image
    if image is not None:
        # Decodes now, so that a broken picture is an error of this file and not of a later step.
        image.load()
    return None if image is None else _tinted(image, part.visual.material)


def _tinted(image: Any, material: Any) -> Any:
    """glTF multiplies the picture by a colour; OBJ does not."""
    factor = getattr(material, "baseColorFactor", None)
    if factor is None or np.all(np.asarray(factor)[:3] == 255):
        return image
    from PIL import Image

    pixels = np.asarray(image.convert("RGB")) * (np.asarray(factor)[:3] / 255)
    return Image.fromarray(np.rint(pixels).astype(np.uint8))


def _file_of(image: Any, path: Path) -> Path | None:
    """The file beside an OBJ that its picture was read from, or None for a picture that is no file."""
    name = image.info.get("file_path")
    return path.parent / str(name) if name and (path.parent / str(name)).is_file() else None


def _warn_of_missing_files(path: Path) -> None:
    """Says which picture or material file a mesh asks for in vain; its shape is read all the same."""
    wanted = [name for name in (_texture_name(path),) if name]
    if path.suffix.lower() == ".obj":
        libraries = _values(path, b"mtllib")
        wanted += libraries
        for library in libraries:
            if (path.parent / library).is_file():
                wanted += _values(path.parent / library, b"map_Kd")
    for name in dict.fromkeys(wanted):
        if not (path.parent / name).is_file():
            _LOG.warning("%s asks for %s, which is not there; it is taken without.", path, name)


def _values(path: Path, key: bytes) -> list[str]:
    """What follows a key on lines of its own in a text file."""
    with open(path, "rb") as stream:
        rows = [line.split(None, 1) for line in stream if line.lstrip().startswith(key)]
    return [row[1].decode(errors="replace").strip() for row in rows if len(row) == 2]


def _with_colors(parts: Sequence[Any]) -> tuple[NDArray[np.float64], NDArray[np.int64], Appearance]:
    """Parts without pictures, one after the other."""
    vertices: list[NDArray[np.float64]] = []
    faces: list[NDArray[np.int64]] = []
    colors: list[NDArray[np.uint8] | None] = []
    count = 0
    for part in parts:
        points, triangles = np.asarray(part.vertices, dtype=np.float64), np.asarray(part.faces, dtype=np.int64)
        color = _flat_color(part)
        if part.visual.kind == "vertex":
            color = np.asarray(part.visual.vertex_colors, dtype=np.uint8)[:, :3]
        elif part.visual.kind == "face":
            points, color = points[triangles].reshape(-1, 3), np.repeat(part.visual.face_colors[:, :3], 3, axis=0)
            triangles = np.arange(len(points)).reshape(-1, 3)
        vertices.append(points)
        faces.append(triangles + count)
        colors.append(None if color is None else np.broadcast_to(color, points.shape).astype(np.uint8))
        count += len(points)
    joined = None
    if any(color is not None for color in colors):
        grey = np.uint8(UNCOLORED)
        joined = np.concatenate(
            [np.full(p.shape, grey) if c is None else c for p, c in zip(vertices, colors, strict=True)]
        )
    return np.concatenate(vertices), np.concatenate(faces), Appearance(joined)


def _flat_color(part: Any) -> NDArray[np.uint8] | None:
    """RGB of the one material of a part, where the file states one."""
    if part.visual.kind != "texture":
        return None
    material = part.visual.material
    stated = getattr(material, "baseColorFactor", None)
    # trimesh makes up a grey where an OBJ file states no colour; only a stated one is kept under its name in the file.
    if stated is None and "kd" in (getattr(material, "kwargs", None) or {}):
        stated = material.diffuse
    return None if stated is None else np.asarray(stated, dtype=np.uint8)[:3]
