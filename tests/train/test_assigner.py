"""SimOTA on a hand-made row of cells."""

import math

import pytest
import torch

from models.detector import RawOutputs
from train.assigner import assign, box_iou, keypoint_similarity
from train.loader import Batch

STRIDE = 8


def row_of_cells(count: int, classes: int = 2) -> RawOutputs:
    """`count` cells of stride 8 side by side; every cell predicts a 16 x 16 box and keypoints at its own centre."""
    centres = torch.stack((torch.arange(count) * 8 + 3.5, torch.full((count,), 3.5)), dim=1)
    boxes = torch.cat((centres - 8, centres + 8), dim=1)[None]
    return RawOutputs(
        class_logits=torch.zeros(1, count, classes),
        boxes=boxes,
        proxy=centres[None, :, None].repeat(1, 1, 4, 1),
        visibility_logits=torch.zeros(1, count, 4),
        pose_vectors=torch.zeros(1, count, 1),
        centres=centres,
        strides=torch.full((count,), 8.0),
    )


def instances(boxes: list[list[float]], classes: list[int], learnt: list[bool] | None = None) -> Batch:
    """Instances whose keypoints all lie in the middle of their boxes."""
    box = torch.tensor([boxes])
    count = len(boxes)
    middle = (box[..., :2] + box[..., 2:]) / 2
    flags = torch.tensor([learnt or [True] * count])
    return Batch(
        images=torch.zeros(1, 3, 8, 8),
        classes=torch.tensor([classes]),
        boxes=box,
        keypoints=middle[:, :, None].repeat(1, 1, 4, 1),
        visible=torch.ones(1, count, 4),
        points=torch.zeros(1, count, 4, 3),
        cameras=torch.eye(3).repeat(1, count, 1, 1),
        diameters=torch.ones(1, count),
        learnt=flags,
        ignored=~flags,
    )


def test_iou_of_worked_boxes() -> None:
    a = torch.tensor([[0.0, 0, 4, 4]])
    assert box_iou(a, torch.tensor([[2.0, 2, 6, 6]])).item() == pytest.approx(4 / 28)
    assert box_iou(a, torch.tensor([[5.0, 5, 6, 6]])).item() == 0


def test_keypoint_similarity_of_a_worked_distance() -> None:
    similarity = keypoint_similarity(torch.tensor([[3.0, 4.0]]), torch.zeros(1, 2), torch.tensor(10.0), sigma=0.25)
    # Tolerance 2 * 0.25 * 10 = 5 pixels, distance 5.
    assert similarity.item() == pytest.approx(math.exp(-0.5))


def test_the_best_cells_learn_as_many_as_their_summed_oks_says() -> None:
    raw = row_of_cells(12)
    batch = instances([[83.5 - 40, -4.5, 83.5 - 24, 11.5]], [1])  # Around cell 6, centre 51.5.
    # Size sqrt(0.53) * 16 = 11.65; with sigma 0.25 the tolerance is 5.82 pixels. OKS of cells 6, 5 and 7, 4 and 8:
    # 1, exp(-64 / 67.8) = 0.39 twice, exp(-256 / 67.8) = 0.023 twice; the sum 1.82 gives one cell.
    assert assign(raw, batch, 0.25, 1)[0].tolist() == [-1] * 6 + [0] + [-1] * 5
    # With sigma 0.5: 1, 0.79 twice, 0.39 twice, 0.12 twice: 3.6, but only candidates (within 20 pixels of the centre)
    # count: cells 4 to 8, whose sum is 3.36. The three best are 6, 5 and 7.
    assert assign(raw, batch, 0.5, 1)[0].tolist() == [-1] * 5 + [0, 0, 0] + [-1] * 4


def test_an_instance_gets_its_least_number_of_cells() -> None:
    batch = instances([[43.5, -4.5, 59.5, 11.5]], [1])
    assert (assign(row_of_cells(12), batch, 0.01, 4)[0] >= 0).sum() == 4


def test_a_contested_cell_goes_to_the_cheaper_instance() -> None:
    raw = row_of_cells(12)
    raw.class_logits[0, 6] = torch.tensor([-4.0, 4.0])
    # Two instances of different classes at one place: cell 6 says class 1.
    batch = instances([[43.5, -4.5, 59.5, 11.5]] * 2, [0, 1])
    assert assign(raw, batch, 0.05, 1)[0, 6] == 1


def test_cost_weighs_boxes_keypoints_and_class_as_rtmo_does() -> None:
    raw = row_of_cells(2)
    batch = instances([[-0.5, -4.5, 15.5, 11.5]], [0])  # Centre 7.5: between cells 0 and 1, both 4 pixels away.
    # Equal boxes and keypoints: the class decides.
    raw.class_logits[0, :, 0] = torch.tensor([-1.0, 1.0])
    assert assign(raw, batch, 0.05, 1)[0].tolist() == [-1, 0]
    # A worse box of cell 1 (IoU 1/3 against 3/5: 3 ln 1.8 = 1.76) outweighs it (cross entropies 0.66 and 0.16).
    raw.class_logits[0, :, 0] = torch.tensor([-1.0, 1.0])
    raw.boxes[0, 1] = torch.tensor([7.5, -4.5, 23.5, 11.5])
    assert assign(raw, batch, 0.05, 1)[0].tolist() == [0, -1]


def test_cells_in_box_and_near_the_centre_come_before_all_others() -> None:
    raw = row_of_cells(30)
    # A box of cells 0 to 20 with centre at cell 10: 0 to 20 are candidates, 8 to 12 near the centre.
    batch = instances([[-0.5, -4.5, 167.5, 11.5]], [0])
    raw.class_logits[0, 2] = torch.tensor([20.0, -20.0])
    raw.boxes[0, 2] = batch.boxes[0, 0]
    raw.proxy[0, 2] = batch.keypoints[0, 0]
    chosen = assign(raw, batch, 0.05, 3)[0]
    assert chosen[2] == -1 and set(torch.nonzero(chosen >= 0)[:, 0].tolist()) <= set(range(8, 13))


def test_instances_that_are_not_to_be_learnt_get_no_cell() -> None:
    batch = instances([[43.5, -4.5, 59.5, 11.5]], [1], [False])
    assert (assign(row_of_cells(12), batch, 0.05, 4) == -1).all()


def test_an_instance_outside_all_cells_is_left_out() -> None:
    batch = instances([[500.0, 500, 516, 516]], [1])
    assert (assign(row_of_cells(12), batch, 0.05, 4) == -1).all()
