"""Tests, and the checker of the shapes and types that signatures state; an int will do where a float is asked."""

from beartype import BeartypeConf, beartype

typechecked = beartype(conf=BeartypeConf(is_pep484_tower=True))
