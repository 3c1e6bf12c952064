"""What Blender makes of shots, surfaces and gravity; pictures are tiny."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from datagen.pictures.renderer import BlenderRenderer, Passes
from datagen.scenes.spec import (
    Lens,
    Motion,
    Moved,
    PlacedInstance,
    SceneSpec,
    Shot,
    Solid,
    Surface,
    Surroundings,
)  # fmt: skip
from multicam.dataset.bop_writer import write_models
from multicam.dataset.objects import Catalogue, ObjectModel
from multicam.geometry import se3, so3
from multicam.geometry.camera import Camera
from multicam.geometry.mesh import Mesh
from multicam.geometry.symmetry import Symmetries

pytestmark = pytest.mark.blender

CAMERA = Camera(np.array([[80.0, 0, 31.5], [0, 80, 23.5], [0, 0, 1]]), 64, 48)
DOWN = se3.from_parts(np.diag([1.0, -1, -1]), np.array([0, 0, 0.5]))
"""Half a metre above the table, looking down; x to the right, y up."""
WHITE = Surroundings(1.0, horizon=(1, 1, 1), zenith=(1, 1, 1))
GREY = Surface((0.5, 0.5, 0.5), roughness=1.0)
EDGE = 0.04
CORNERS = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]) * EDGE
FACES = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4],
     [1, 5, 7], [1, 7, 3]]
)  # fmt: skip
RED_AND_BLUE = np.where(CORNERS[:, :1] < 0, [[200, 20, 20]], [[20, 20, 200]]).astype(np.uint8)
"""A cube whose left half is red, and whose right half is blue."""


@pytest.fixture(scope="module")
def cube(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A models folder."""
    folder = tmp_path_factory.mktemp("cube")
    box = np.stack((CORNERS.min(0), CORNERS.max(0)))
    model = ObjectModel(1, "cube", EDGE * 3**0.5, Symmetries(), box, CORNERS)
    write_models(folder, Catalogue({1: model}), {1: Mesh(CORNERS, FACES, RED_AND_BLUE)})
    return folder


@pytest.fixture(scope="module")
def blender(cube: Path) -> Iterator[BlenderRenderer]:
    with BlenderRenderer(cube, 4) as renderer:
        yield renderer


def at(x: float, y: float, z: float) -> np.ndarray:
    return se3.from_parts(np.eye(3), np.array([x, y, z]))


def scene(*shots: Shot, surface: Surface = GREY, solids: tuple[Solid, ...] = ()) -> SceneSpec:
    table = Solid("box", np.array([2, 2, 0.02]), at(0, 0, -0.01), Surface((0.1, 0.1, 0.1), roughness=1.0))
    cube = PlacedInstance(1, at(0, 0, EDGE / 2), surface)
    return SceneSpec("test", 5, (cube,), (table, *solids), (), WHITE, shots or (Shot(CAMERA, DOWN),))


def render(blender: BlenderRenderer, spec: SceneSpec) -> list[Passes]:
    return list(blender.render(spec, range(len(spec.shots))))


def test_blur_changes_the_picture_and_no_label(blender: BlenderRenderer) -> None:
    sharp = Shot(CAMERA, DOWN)
    moving = replace(sharp, motion=Motion(np.array([0, 0.1, 0, 0, 0, 0])))
    rolling = replace(sharp, motion=Motion(np.array([0, 0.1, 0, 0, 0, 0]), 0.1))
    focused = replace(sharp, lens=Lens(focus=0.2, f_number=0.3))
    first, *blurred, last = render(blender, scene(sharp, moving, rolling, focused, sharp))
    for passes in blurred:
        assert np.array_equal(passes.index, first.index)
        assert np.array_equal(passes.depth, first.depth)
        assert np.abs(passes.color - first.color).max() > 0.02
        assert passes.alpha.sum() == pytest.approx(first.alpha.sum(), rel=0.1)
    # Rows that are exposed for a moment each are sharp; otherwise edges get wide.
    edges = [int(((p.alpha > 0.05) & (p.alpha < 0.95)).sum()) for p in (first, *blurred)]
    assert edges[1] > 1.3 * edges[0]
    assert edges[3] > 1.3 * edges[0]
    assert np.array_equal(first.index, last.index)
    assert np.array_equal(first.depth, last.depth)


def test_motion_moves_the_picture_the_right_way(blender: BlenderRenderer) -> None:
    """Rows are exposed from top to bottom, so a camera that turns to its right sees lower rows further to the left."""
    twist = np.array([0, 0.3, 0, 0, 0, 0])
    (rolling,) = render(blender, scene(Shot(CAMERA, DOWN, motion=Motion(twist, 0.05))))
    covered = rolling.alpha > 0.5
    rows = np.flatnonzero(covered.any(axis=1))
    middle = [np.flatnonzero(covered[row]).mean() for row in rows]
    slope = np.polyfit(rows, middle, 1)[0]
    # A turn of 0.3 rad is 24 pixels at 80 pixels focal length, over 48 rows.
    assert slope == pytest.approx(-0.5, abs=0.15)


def test_a_picture_does_not_depend_on_those_before_it(cube: Path) -> None:
    """Down to the last bit, which needs poses with all bits in use."""
    aslant = se3.plus(DOWN, np.array([0.31, 0.23, 0.17, 0.011, 0.007, 0.003]))
    shot, many = Shot(CAMERA, aslant), np.random.default_rng(0).normal(size=(20, 6)) * ([0.7] * 3 + [0.1] * 3)
    spec = scene(replace(shot, motion=Motion(np.full(6, 0.02))), replace(shot, lens=Lens(focus=0.3, f_number=2)), shot)
    spec = replace(spec, objects=tuple(PlacedInstance(1, se3.plus(at(0, 0, 0.1), xi), GREY) for xi in many))
    with BlenderRenderer(cube, 4) as first, BlenderRenderer(cube, 4) as second:
        together, (alone,) = list(first.render(spec, [0, 1, 2]))[2], second.render(spec, [2])
    for name in ("color", "depth", "index", "alpha"):
        assert np.array_equal(getattr(alone, name), getattr(together, name))


def test_alpha_is_the_share_of_labelled_objects(blender: BlenderRenderer) -> None:
    (passes,) = render(blender, scene())
    inner = cv2.erode((passes.index == 1).astype(np.uint8), np.ones((3, 3))) > 0
    outer = cv2.dilate((passes.index == 1).astype(np.uint8), np.ones((3, 3))) > 0
    assert inner.sum() > 10
    assert np.all(passes.alpha[inner] > 0.999)
    assert np.all(passes.alpha[~outer] == 0)
    # The top face is 0.46 m away and 0.04 m wide: 48.4 square pixels.
    assert passes.alpha.sum() == pytest.approx((80 * EDGE / (0.5 - EDGE)) ** 2, rel=0.06)


def test_objects_keep_their_own_colours_if_asked_to(blender: BlenderRenderer) -> None:
    (own,) = render(blender, scene(surface=replace(GREY, color=(1, 1, 1), original=True)))
    (grey,) = render(blender, scene())
    left, right = ((24, 29), (24, 34))
    assert own.color[left][0] > 3 * own.color[left][2]
    assert own.color[right][2] > 3 * own.color[right][0]
    assert np.ptp(grey.color[left]) < 0.05


def test_a_picture_lies_over_the_top_of_a_box(blender: BlenderRenderer, tmp_path: Path) -> None:
    """Its right is +x and its top +y."""
    quarters = np.zeros((8, 8, 3), np.uint8)
    quarters[:4, :4], quarters[:4, 4:], quarters[4:, :4] = (0, 0, 255), (0, 255, 0), (255, 0, 0)
    cv2.imwrite(str(tmp_path / "quarters.png"), quarters)
    surface = Surface((1, 1, 1), roughness=1.0, picture=str(tmp_path / "quarters.png"))
    board = Solid("box", np.array([0.2, 0.2, 0.01]), at(0, 0, 0.2), surface)
    (passes,) = render(blender, scene(solids=(board,)))
    found = [int(np.argmax(passes.color[row, column])) for row, column in ((10, 18), (10, 45), (37, 18))]
    assert found == [0, 1, 2]
    assert passes.color[37, 45].max() < 0.1


def test_the_background_is_seen_and_gives_no_light(blender: BlenderRenderer) -> None:
    def sky(backdrop: Surface | None) -> Passes:
        spec = scene()
        return render(blender, replace(spec, solids=(), surroundings=replace(WHITE, backdrop=backdrop)))[0]

    plain, green = sky(None), sky(Surface((0, 1, 0), (0, 0.5, 0), "checker", 4.0))
    behind = plain.index == 0
    assert np.all(green.color[behind & (green.alpha == 0)][:, 0] < 0.01)
    lit = [p.color[green.alpha == 1].mean(axis=0) for p in (green, plain)]
    assert np.allclose(*lit, atol=0.02)


def test_objects_stand_elsewhere_in_one_shot(blender: BlenderRenderer) -> None:
    shot = Shot(CAMERA, DOWN)
    aside = replace(shot, moved=(Moved(0, at(0.1, 0, EDGE / 2)),))
    here, there, again = render(blender, scene(shot, aside, shot))
    shift = np.nonzero(there.index)[1].mean() - np.nonzero(here.index)[1].mean()
    assert shift == pytest.approx(80 * 0.1 / (0.5 - EDGE), abs=1)
    assert np.array_equal(here.depth, again.depth)


def test_loose_objects_fall_and_mounted_ones_stay(blender: BlenderRenderer) -> None:
    spec = scene()
    tilted = se3.from_parts(so3.exp(np.array([0.3, 0.2, 0])), np.array([0, 0, 0.1]))
    objects = (
        PlacedInstance(1, tilted, GREY), PlacedInstance(1, at(0.3, 0, 0.1), GREY, mounted=True),
        PlacedInstance(1, at(0.3, 0, 0.2), GREY),
    )  # fmt: skip
    settled = [blender.settle(replace(spec, objects=objects)).objects for _ in range(2)]
    for first, second in zip(*settled, strict=True):
        assert np.array_equal(first.world_from_object, second.world_from_object)
    lying, mounted, stacked = (item.world_from_object for item in settled[0])
    assert se3.act(lying, CORNERS)[:, 2].min() == pytest.approx(0, abs=1.5e-3)
    assert np.abs(lying[2, :3]).max() > 0.999
    assert np.array_equal(mounted, at(0.3, 0, 0.1))
    assert stacked[2, 3] == pytest.approx(0.1 + EDGE, abs=2e-3)
