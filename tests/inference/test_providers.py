"""Execution providers: what each is told, and sentences where one is missing, does not start or cannot run a file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import onnxruntime as ort
import pytest
from onnxruntime.capi import onnxruntime_pybind11_state as ort_errors

from multicam.dataset.objects import Catalogue
from multicam.errors import ConfigError, ModelError
from multicam.inference.metadata import NetworkMetadata
from multicam.inference.providers import PROVIDERS, chosen_providers
from multicam.inference.session import Network, SessionConfig
from tests.inference.toy_network import HEIGHT, WIDTH, answer, picture_for, write_network

CPU = "CPUExecutionProvider"


class Machine:
    """Stands in for a machine with other providers: records what sessions are asked for, and runs them on the CPU."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *names: str) -> None:
        self.asked: list[Any] = []
        self.starts, self.objection = True, ""
        self.session = ort.InferenceSession
        providers = [PROVIDERS[name] for name in names]
        monkeypatch.setattr(ort, "get_available_providers", lambda: [*providers, CPU])
        monkeypatch.setattr(ort, "InferenceSession", self.open)

    def open(self, path: str, options: ort.SessionOptions, providers: list[Any]) -> Any:
        if providers == [CPU]:
            return self.session(path, options, providers=providers)
        self.asked = providers
        if self.objection:
            raise ort_errors.Fail(self.objection)
        session = self.session(path, options, providers=[CPU])
        if self.starts:
            session.get_providers = lambda: [name for name, _ in providers]
        return session


@pytest.fixture
def network_file(tmp_path: Path, catalogue: Catalogue) -> Path:
    return network_of(tmp_path / "toy.onnx", catalogue, "fp32")


def network_of(path: Path, catalogue: Catalogue, precision: Any) -> Path:
    metadata = NetworkMetadata(tuple(catalogue.objects.values()), WIDTH, HEIGHT, "CC0-1.0", precision=precision)
    return write_network(path, [answer([0], [0.9], [[1, 2, 11, 12]])], metadata.to_json())


def test_the_chosen_provider_runs_the_network(monkeypatch: pytest.MonkeyPatch, network_file: Path) -> None:
    machine = Machine(monkeypatch, "cuda")
    network = Network(network_file, SessionConfig(provider="cuda", device="1"))
    assert machine.asked == [("CUDAExecutionProvider", {"device_id": "1"})]
    assert len(network.detect([picture_for(0)])[0]) == 1


def test_the_cpu_is_opened_once(monkeypatch: pytest.MonkeyPatch, network_file: Path) -> None:
    machine = Machine(monkeypatch)
    Network(network_file)
    assert machine.asked == []


def test_tensorrt_keeps_its_engines_and_leaves_the_rest_to_cuda(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, catalogue: Catalogue
) -> None:
    machine = Machine(monkeypatch, "tensorrt", "cuda")
    path = network_of(tmp_path / "half.onnx", catalogue, "fp16")
    Network(path, SessionConfig(provider="tensorrt", device="1", cache=tmp_path / "kept"))
    (name, options), cuda = machine.asked
    assert name == "TensorrtExecutionProvider"
    assert options["trt_engine_cache_path"] == options["trt_timing_cache_path"] == str(tmp_path / "kept")
    assert options["trt_engine_cache_enable"] == options["trt_fp16_enable"] == "True"
    assert cuda == ("CUDAExecutionProvider", {"device_id": "1"})


def test_tensorrt_computes_single_precision_in_single_precision(monkeypatch: pytest.MonkeyPatch) -> None:
    Machine(monkeypatch, "tensorrt")
    assert chosen_providers(SessionConfig(provider="tensorrt"), "fp32") == [("TensorrtExecutionProvider", {})]


def test_openvino_is_told_device_threads_and_cache(monkeypatch: pytest.MonkeyPatch, network_file: Path) -> None:
    machine = Machine(monkeypatch, "openvino")
    Network(network_file, SessionConfig(provider="openvino", threads=2, device="GPU", cache=Path("kept")))
    wanted = {"device_type": "GPU", "num_of_threads": "2", "cache_dir": "kept"}
    assert machine.asked == [("OpenVINOExecutionProvider", wanted)]


def test_a_provider_that_does_not_start_is_not_replaced(monkeypatch: pytest.MonkeyPatch, network_file: Path) -> None:
    Machine(monkeypatch, "cuda").starts = False
    with pytest.raises(ModelError, match=r'"cuda" is built in but did not start: are its drivers .* Choose "cpu"'):
        Network(network_file, SessionConfig(provider="cuda"))


def test_what_a_provider_objects_to_is_not_taken_for_a_damaged_file(
    monkeypatch: pytest.MonkeyPatch, network_file: Path
) -> None:
    Machine(monkeypatch, "cuda").objection = "CUDA failure 100: no device.\nstack"
    with pytest.raises(ModelError, match=r'"cuda" cannot run .*toy\.onnx \(CUDA failure 100: no device\);') as caught:
        Network(network_file, SessionConfig(provider="cuda"))
    assert "damaged" not in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_damaged_file_is_not_taken_for_a_fault_of_the_provider(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    Machine(monkeypatch, "cuda")
    path = tmp_path / "x.onnx"
    path.write_text("hello")
    with pytest.raises(ModelError, match="damaged"):
        Network(path, SessionConfig(provider="cuda"))


def test_tensorrt_refuses_8_bit_networks(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, catalogue: Catalogue) -> None:
    Machine(monkeypatch, "tensorrt", "cuda")
    path = network_of(tmp_path / "int8.onnx", catalogue, "int8")
    with pytest.raises(ModelError, match="--precision fp16"):
        Network(path, SessionConfig(provider="tensorrt"))


@pytest.mark.parametrize(
    ("name", "package"),
    [("cuda", "onnxruntime-gpu"), ("tensorrt", "TensorRT itself"), ("openvino", "onnxruntime-openvino")],
)
def test_the_package_that_carries_a_missing_provider_is_named(
    monkeypatch: pytest.MonkeyPatch, network_file: Path, name: str, package: str
) -> None:
    Machine(monkeypatch)
    with pytest.raises(ModelError, match=f'no execution provider "{name}", only cpu; .*{package}'):
        Network(network_file, SessionConfig(provider=name))


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"device": "1"}, '"cpu" has no devices'),
        ({"provider": "cuda", "device": "GPU"}, "numbers from 0 on"),
        ({"provider": "cuda", "cache": Path("x")}, "compiles nothing"),
        ({"threads": -1}, "threads must be 0"),
    ],
)
def test_options_that_do_not_fit_the_provider_are_refused(options: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ConfigError, match=sentence):
        SessionConfig(**options)
