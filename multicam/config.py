"""Configuration: frozen dataclasses, YAML holding only differences, typed flags on top.

Order of precedence: dataclass defaults, then `--config FILE.yaml`, then flags. Unknown keys, wrong types and
misspelt flags are refused with a suggestion; the resolved configuration is saved beside every output.
"""

from __future__ import annotations

import copy
import dataclasses
import re
import types as python_types
from collections.abc import Hashable, Sequence
from pathlib import Path
from typing import Any, Literal, TypeVar, Union, cast, get_args, get_origin, get_type_hints

import cattrs
import yaml

from multicam.errors import ConfigError, did_you_mean
from multicam.files import require_file, write_text

Config = TypeVar("Config")


class _Loader(yaml.SafeLoader):
    """Safe YAML that reads 1e-3 as a number and refuses a key given twice."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        keys = [self.construct_object(key, deep=True) for key, _ in node.value]
        for key in keys:
            if keys.count(key) > 1:
                raise yaml.constructor.ConstructorError(None, None, f'the key "{key}" is given twice', node.start_mark)
        return super().construct_mapping(node, deep=deep)


class _Dumper(yaml.SafeDumper):
    """Quotes what `_Loader` would take for something else than a string."""


for _style in (_Loader, _Dumper):
    _style.add_implicit_resolver(
        "tag:yaml.org,2002:float", re.compile(r"^[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$"), list("-+.0123456789")
    )


def read_yaml(path: Path) -> dict[str, Any]:
    """Reads a YAML mapping; an empty file is an empty mapping.

    Raises:
        ConfigError: malformed YAML, a key given twice, or a document that is not a mapping.
        DataError: the file is missing.
    """
    require_file(path, "configuration file")
    try:
        value = yaml.load(path.read_text(encoding="utf-8"), Loader=_Loader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        where = f" at line {mark.line + 1}, column {mark.column + 1}" if mark else ""
        raise ConfigError(f"{path} is not valid YAML: {error.problem}{where}.") from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path} is not valid YAML: it holds characters that YAML does not allow.") from error
    if value is None:
        return {}
    if not isinstance(value, dict):
        raise ConfigError(
            f"{path} holds a {type(value).__name__} at its top; write a mapping, one `key: value` a line."
        )
    return value  # pyright: ignore[reportUnknownVariableType]


def from_mapping(schema: type[Config], mapping: dict[str, Any], source: str) -> Config:
    """Builds a frozen dataclass from plain data, strictly.

    Raises:
        ConfigError: the first unknown key or unfit value, with its path, what was there and what is expected.
    """
    _check_structure(schema, mapping, source, "")
    try:
        return _converter().structure(mapping, schema)
    except cattrs.BaseValidationError as error:
        problem = cattrs.transform_error(error, path="", format_exception=_reason)[0]
        reason, _, where = problem.rpartition(" @ ")
        raise ConfigError(f"{': '.join(filter(None, (source, where.lstrip('.'), reason)))}.") from error


def load_config(schema: type[Config], path: Path | None = None) -> Config:
    """Returns the defaults of `schema`, changed by the YAML file if one is given."""
    return from_mapping(schema, read_yaml(path), str(path)) if path else schema()


def to_mapping(config: Any) -> dict[str, Any]:
    """Returns the configuration as plain data that YAML and JSON can hold."""
    return _converter().unstructure(config)


def save_config(config: Any, path: Path) -> None:
    """Writes the resolved configuration as YAML, atomically; `load_config` reads it back unchanged."""
    write_text(path, yaml.dump(to_mapping(config), Dumper=_Dumper, sort_keys=False))


def parse_command(schema: type[Config], argv: Sequence[str], prog: str, description: str) -> Config:
    """Reads `--config FILE.yaml` and then the flags of a subcommand into its configuration.

    Raises:
        ConfigError: the file does not fit.
        SystemExit: code 0 after --help, code 2 after a flag that does not fit (with suggestions).
    """
    import tyro

    rest, path = _split_config_flag(list(argv))
    default = _with_missing(schema, read_yaml(path) if path else {}, str(path))
    text = f"{description}\n\n--config FILE.yaml sets any of the options below; flags override the file."
    # Else every part that may be null becomes a subcommand; such a part is set to null by a file.
    flat = (tyro.conf.AvoidSubcommands,)
    return tyro.cli(schema, args=rest, prog=prog, description=text, default=default, config=flat)


def _with_missing(schema: type[Config], mapping: dict[str, Any], source: str) -> Config:
    """As `from_mapping`; fields without a default that the mapping lacks too are left for the flags to give."""
    import tyro

    _check_structure(schema, mapping, source, "")
    fields: tuple[dataclasses.Field[Any], ...] = dataclasses.fields(cast(Any, schema))
    missing = {f.name for f in fields if f.default is f.default_factory is dataclasses.MISSING} - mapping.keys()
    hints = get_type_hints(schema)
    given = [(f.name, hints[f.name], copy.copy(f)) for f in fields if f.name not in missing]
    known = from_mapping(dataclasses.make_dataclass("Known", given), mapping, source)
    return schema(**vars(known), **dict.fromkeys(missing, tyro.MISSING))


def _split_config_flag(argv: list[str]) -> tuple[list[str], Path | None]:
    for index, flag in enumerate(argv):
        if flag == "--config":
            if index + 1 == len(argv):
                raise ConfigError("--config needs a file; give it as --config FILE.yaml.")
            return argv[:index] + argv[index + 2 :], Path(argv[index + 1])
        if flag.startswith("--config="):
            return argv[:index] + argv[index + 1 :], Path(flag.split("=", 1)[1])
    return argv, None


def _check_structure(schema: Any, value: Any, source: str, path: str) -> None:
    """Walks plain data beside its schema, for what cattrs reports without a suggestion, or takes in silence.

    A string is a sequence of its letters to cattrs, and a mapping one of its keys.
    """
    if get_origin(schema) in (Union, python_types.UnionType):
        if value is None and type(None) in get_args(schema):
            return
        schema = next((s for s in get_args(schema) if get_origin(s) is tuple or dataclasses.is_dataclass(s)), None)
    if get_origin(schema) is tuple:
        if not isinstance(value, list | tuple):
            raise ConfigError(f"{source}: {path}: expected a list, got {value!r}.")
        for index, item in enumerate(value):
            _check_structure(get_args(schema)[0], item, source, f"{path}[{index}]")
    if not dataclasses.is_dataclass(schema):
        return
    if not isinstance(value, dict):
        raise ConfigError(f"{source}: {path}: expected a mapping of options, got {value!r}.")
    hints = get_type_hints(schema)
    for key, item in value.items():
        name = f"{path}.{key}" if path else str(key)
        if key not in hints:
            valid = ", ".join(hints)
            raise ConfigError(
                f'{source}: unknown key "{name}"{did_you_mean(str(key), hints)}; the keys there are {valid}.'
            )
        _check_structure(hints[key], item, source, name)


def _reason(error: BaseException, kind: type | None) -> str:
    """What one field objects to; cattrs would name the type alone and drop the words of a check of ours."""
    if isinstance(error, ValueError):
        return str(error).rstrip(".")
    return cattrs.v.format_exception(error, kind)


def _converter() -> cattrs.Converter:
    converter = cattrs.Converter(forbid_extra_keys=True)
    # cattrs coerces by calling the type, and bool("False") is true; we take only what was meant.
    converter.register_structure_hook(bool, lambda value, _: _expect(value, bool))
    converter.register_structure_hook(int, lambda value, _: _expect(value, int))
    converter.register_structure_hook(float, lambda value, _: float(_expect(value, float, int)))
    converter.register_structure_hook(str, lambda value, _: _expect(value, str))
    converter.register_structure_hook(Path, lambda value, _: Path(_expect(value, str)))
    converter.register_structure_hook_func(lambda kind: get_origin(kind) is Literal, _choose)
    converter.register_unstructure_hook(Path, str)
    return converter


def _expect(value: Any, *kinds: type) -> Any:
    if not isinstance(value, kinds) or (isinstance(value, bool) and bool not in kinds):
        raise ValueError(f"expected {kinds[0].__name__}, got {value!r}")
    return value


def _choose(value: Any, literal: Any) -> Any:
    options = [str(option) for option in get_args(literal)]
    if value not in get_args(literal):
        raise ValueError(f"expected one of {', '.join(options)}, got {value!r}{did_you_mean(str(value), options)}")
    return value
