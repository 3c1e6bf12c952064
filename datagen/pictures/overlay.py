"""Patches right before the camera, drawn into the passes of a render."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from datagen.pictures.renderer import Passes
from datagen.scenes.spec import Overlay
from multicam.dataset.bop_reader import read_image

_BEFORE_CAMERA = 0.05
"""Metres; nearer than any object, so that nothing behind a patch counts as visible."""
_BRIGHT = 90
"""Percentile of the picture's values that an overlay's colour 1 stands for."""


def overlaid(passes: Passes, overlays: tuple[Overlay, ...]) -> Passes:
    """The passes with all patches in front: their colours, their depth, no index and no alpha."""
    if not overlays:
        return passes
    color, depth, index, alpha = (a.copy() for a in (passes.color, passes.depth, passes.index, passes.alpha))
    bright = float(np.percentile(passes.color, _BRIGHT))
    for overlay in overlays:
        inside = np.zeros(depth.shape, dtype=np.uint8)
        cv2.fillPoly(inside, [np.rint(overlay.outline).astype(np.int32)], (1,))
        hidden = inside > 0
        color[hidden] = bright * _paint(overlay, hidden)
        depth[hidden], index[hidden], alpha[hidden] = _BEFORE_CAMERA, 0, 0
    return replace(passes, color=color, depth=depth, index=index, alpha=alpha)


def _paint(overlay: Overlay, hidden: NDArray[np.bool_]) -> NDArray[np.float32]:
    """(n, 3) linear colours of the hidden pixels, or one colour (3,) for all."""
    if overlay.picture is None or not hidden.any():
        return np.array(overlay.color, dtype=np.float32)
    rows, columns = np.nonzero(hidden)
    top, left = rows.min(), columns.min()
    size = int(columns.max() - left + 1), int(rows.max() - top + 1)
    picture = cv2.resize(read_image(Path(overlay.picture)), size, interpolation=cv2.INTER_AREA)
    return (picture[rows - top, columns - left] / np.float32(255)) ** np.float32(2.2)
