"""Pages from the templates of this package."""

from __future__ import annotations

from typing import Any


def filled(template: str, **values: Any) -> str:
    """A template with its values; all that is not marked safe is escaped."""
    from jinja2 import Environment, PackageLoader

    environment = Environment(
        loader=PackageLoader("multicam.visualization"), autoescape=True, trim_blocks=True, lstrip_blocks=True
    )
    return environment.get_template(template).render(**values)
