"""Execution providers of ONNX Runtime: which there are, and what each is told."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import onnxruntime as ort

from multicam.errors import ConfigError, ModelError, did_you_mean

PROVIDERS = {
    "cpu": "CPUExecutionProvider",
    "cuda": "CUDAExecutionProvider",
    "tensorrt": "TensorrtExecutionProvider",
    "openvino": "OpenVINOExecutionProvider",
    "directml": "DmlExecutionProvider",
    "coreml": "CoreMLExecutionProvider",
}
"""Our names of execution providers, and ONNX Runtime's."""

_PACKAGES = {
    "cuda": "onnxruntime-gpu",
    "tensorrt": "onnxruntime-gpu, and TensorRT itself",
    "openvino": "onnxruntime-openvino",
    "directml": "onnxruntime-directml, on Windows",
    "coreml": "onnxruntime, on macOS",
}
"""What carries the providers that the plain package lacks; one such package takes the place of `onnxruntime`."""

_NUMBERED = ("cuda", "tensorrt", "directml")
"""Providers whose devices have numbers."""

_COMPILING = ("tensorrt", "openvino")
"""Providers that compile the network, and can keep what they made."""

Chosen = tuple[str, dict[str, str]]
"""A provider by ONNX Runtime's name, with its options."""


@dataclass(frozen=True)
class SessionConfig:
    """Where and how the network runs."""

    provider: str = "cpu"
    """Execution provider: cpu, cuda, tensorrt, openvino, directml or coreml; never replaced silently."""
    threads: int = 0
    """CPU threads of one operator; 0 takes all cores."""
    device: str | None = None
    """Device of the provider: a number for cuda, tensorrt and directml; CPU, GPU or NPU for openvino."""
    cache: Path | None = None
    """Folder in which tensorrt and openvino keep the network as they compiled it, which can take them minutes."""

    def __post_init__(self) -> None:
        if self.threads < 0:
            raise ConfigError(f"threads must be 0 (all cores) or more; it is {self.threads}.")
        if self.device is not None and self.provider not in (*_NUMBERED, "openvino"):
            raise ConfigError(
                f'the execution provider "{self.provider}" has no devices to choose from, but device is '
                f'"{self.device}"; leave it out.'
            )
        if self.device is not None and self.provider in _NUMBERED and not self.device.isdecimal():
            raise ConfigError(f'the devices of "{self.provider}" are numbers from 0 on, but device is "{self.device}".')
        if self.cache is not None and self.provider not in _COMPILING:
            raise ConfigError(
                f'the execution provider "{self.provider}" compiles nothing that could be kept in {self.cache}; '
                f"leave cache out, it is for {' and '.join(_COMPILING)}."
            )


def available_providers() -> list[str]:
    """Our names of the providers that this ONNX Runtime was built with."""
    return [ours for ours, theirs in PROVIDERS.items() if theirs in ort.get_available_providers()]


def require_provider(name: str) -> None:
    """Accepts a provider that this ONNX Runtime has.

    Raises:
        ModelError: there is no such provider, or not here; the sentence says what to install.
    """
    if name not in PROVIDERS:
        raise ModelError(
            f'unknown execution provider "{name}"{did_you_mean(name, PROVIDERS)}; there are {", ".join(PROVIDERS)}.'
        )
    available = available_providers()
    if name not in available:
        raise ModelError(
            f'this ONNX Runtime has no execution provider "{name}", only {", ".join(available)}; install the '
            f"package that carries it ({_PACKAGES.get(name, 'onnxruntime')}) in place of onnxruntime."
        )


def chosen_providers(config: SessionConfig, precision: str) -> list[Chosen]:
    """The provider with its options, for a network of the given precision; a session falls back on no other one.

    TensorRT leaves the operations that it lacks to CUDA, and any provider leaves some to the CPU: that is how ONNX
    Runtime divides a graph, and not a replacement.

    Raises:
        ModelError: a precision that the provider cannot run.
    """
    name = config.provider
    if name == "tensorrt" and precision == "int8":
        raise ModelError(
            'TensorRT takes only 8-bit networks whose zero points are 0, and ours have others; choose "cuda" or "cpu", '
            "or export the network again with --precision fp16."
        )
    options: dict[str, str] = {}
    if config.device is not None:
        options["device_type" if name == "openvino" else "device_id"] = config.device
    if name == "openvino":
        options |= {"num_of_threads": str(config.threads)} if config.threads else {}
        options |= {"cache_dir": str(config.cache)} if config.cache else {}
    if name == "tensorrt":
        options |= {"trt_fp16_enable": "True"} if precision == "fp16" else {}
        if config.cache:
            kept = {"trt_engine_cache_enable": "True", "trt_engine_cache_path": str(config.cache)}
            options |= kept | {"trt_timing_cache_enable": "True", "trt_timing_cache_path": str(config.cache)}
    chosen: list[Chosen] = [(PROVIDERS[name], options)]
    if name == "tensorrt" and "cuda" in available_providers():
        chosen.append((PROVIDERS["cuda"], {"device_id": config.device} if config.device else {}))
    return chosen
