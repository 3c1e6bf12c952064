"""Subcommands of the runtime; each has a `main(argv)`."""
