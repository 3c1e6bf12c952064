"""Training: BOP data in, checkpoints out."""
