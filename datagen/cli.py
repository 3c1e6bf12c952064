"""`multicam datagen`: the verbs that make data sets."""

from __future__ import annotations

import importlib
import logging
import sys

from multicam.errors import ConfigError, MulticamError, did_you_mean

_VERBS = {
    "models": ("datagen.instruments.command", "write the nine instruments as a BOP models folder"),
    "import": ("datagen.commands.import_parts", "make a BOP models folder of CAD files (PLY, OBJ, STL, GLB)"),
    "keypoints": ("datagen.commands.keypoints", "add keypoints to a BOP models folder of your own"),
    "inspect": ("datagen.commands.inspect", "show a data set or a models folder on one HTML page"),
    "render": ("datagen.commands.render", "render a labelled data set of random scenes"),
    "verify": ("datagen.commands.verify", "compare a rendered data set with its manifests: is all there, and whole?"),
    "sequence": ("datagen.commands.sequence", "render a recording with one moving and two static cameras"),
}


def main(argv: list[str]) -> None:
    """Runs a verb; its module is imported only then.

    Raises:
        ConfigError: no such verb.
    """
    if not argv or argv[0] in ("-h", "--help"):
        lines = [f"  {verb:9} {text}" for verb, (_, text) in _VERBS.items()]
        sys.stdout.write("usage: multicam datagen VERB [--help] [options]\n\n" + "\n".join(lines) + "\n")
        return
    verb, rest = argv[0], argv[1:]
    if verb not in _VERBS:
        verbs = ", ".join(_VERBS)
        raise ConfigError(f'"{verb}" is no verb of multicam datagen{did_you_mean(verb, _VERBS)}; there are {verbs}.')
    importlib.import_module(_VERBS[verb][0]).main(rest)


if __name__ == "__main__":
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    try:
        main(sys.argv[1:])
    except MulticamError as error:
        sys.stderr.write(f"multicam datagen: {error}\n")
        sys.exit(2)
