"""What each process of test_distributed.py runs: `torchrun distributed_worker.py CONFIG.yaml`."""

import sys
from pathlib import Path

import torch
import torch.distributed as dist
from torch import nn

from multicam.config import load_config
from multicam.progress import SilentProgress
from train.config import TrainConfig
from train.distributed import StopSignal, process_group
from train.fit import Run
from train.shared_norm import SharedNorm, share_norms


def check_norm(rank: int, split: int) -> None:
    """Rows 0 to split - 1 in the first process and the rest in the second give what one process gives."""
    torch.manual_seed(1)
    x, seen = torch.randn(7, 3, dtype=torch.float64) * 3 + 2, torch.randn(7, 3, dtype=torch.float64)
    alone = nn.BatchNorm1d(3, momentum=0.1).double()
    nn.init.normal_(alone.weight)
    holder = nn.Sequential(nn.BatchNorm1d(3, momentum=0.1).double())
    holder.load_state_dict({f"0.{name}": value for name, value in alone.state_dict().items()})
    share_norms(holder)
    assert isinstance(holder[0], SharedNorm)
    mine = slice(0, split) if rank == 0 else slice(split, 7)
    whole, part = x.clone().requires_grad_(), x[mine].clone().requires_grad_()
    expected, got = alone(whole), holder(part)
    expected.backward(seen)
    got.backward(seen[mine])
    assert whole.grad is not None and part.grad is not None and holder[0].weight.grad is not None
    torch.testing.assert_close(got, expected[mine])
    torch.testing.assert_close(part.grad, whole.grad[mine])
    torch.testing.assert_close(holder[0].running_mean, alone.running_mean)
    torch.testing.assert_close(holder[0].running_var, alone.running_var)
    for_weight = holder[0].weight.grad.clone()
    dist.all_reduce(for_weight)
    torch.testing.assert_close(for_weight, alone.weight.grad)


def main(path: Path) -> None:
    """Checks the norms, then trains as the configuration says."""
    torch.set_num_threads(1)
    with process_group("cpu") as group, StopSignal().watching() as stop:
        if group.processes > 1:
            for split in (3, 0, 7):
                check_norm(group.rank, split)
        run = Run(load_config(TrainConfig, path), group, SilentProgress())
        run.train(stop)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
