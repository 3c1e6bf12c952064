"""What one training run is: data, network, stages, augmentation, machine."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

from models.config import ModelConfig, NeckName, Size
from multicam.dataset.objects import Catalogue
from multicam.errors import ConfigError, DataError

OptimizerName = Literal["adamw", "muon"]

WINDOWS = 4
"""Windows that are put together to one picture in training."""


@dataclass(frozen=True)
class DataConfig:
    """Where the pictures are; all in BOP format."""

    train: tuple[Path, ...] = (Path("data/instruments/train"),)
    """Splits (folders of scene folders) to learn from."""
    validation: tuple[Path, ...] = (Path("data/instruments/val"),)
    """Splits to measure on; none may be given."""
    models: Path = Path("data/instruments/models")
    """BOP models folder with meshes, models_info.json and keypoints.json."""
    cache: bool = True
    """Keep decoded pictures in memory; for small pictures."""
    validation_limit: int = 200
    """Pictures to validate on, spread evenly over the split."""


@dataclass(frozen=True)
class NetworkConfig:
    """The network; classes and keypoints come from the models folder."""

    size: Size = "m"
    """nano, tiny, s, m, l or x."""
    neck: NeckName = "hybrid"
    """hybrid (RT-DETR's, as RTMO) or pafpn (YOLOX's)."""
    strides: tuple[int, ...] = (8, 16, 32)
    """Levels of the head: 8 16 32, or 16 32 as RTMO."""
    bins: int = 256
    """Bins per axis of the coordinate classifier."""
    input_width: int = 640
    """Pixels, a multiple of 32."""
    input_height: int = 640
    """Pixels, a multiple of 32; need not equal the width."""
    window_width: int = 0
    """Pixels of a picture to learn from where that is a window of what the network will see, as camera.window of the
    renderer makes them; at least half of the input, for four of them are learnt as one. 0 where pictures are whole."""
    window_height: int = 0
    """See window_width."""
    depthwise: bool = False
    """Depthwise convolutions in backbone and pafpn neck, as in the nano that YOLOX publishes."""

    def __post_init__(self) -> None:
        for what, (width, height) in {"input": self.input_size, "window": self.window_size}.items():
            if width % 32 or height % 32 or min(width, height) < 64:
                raise ConfigError(
                    f"the network's {what} must be at least 64 and a multiple of 32 on each side; "
                    f"{width} x {height} is not."
                )

        (width, height), (whole, tall) = self.window_size, self.input_size
        if 2 * width < whole or 2 * height < tall:
            raise ConfigError(
                f"windows of {width} x {height} are less than half as wide or high as the network's input, {whole} x "
                f"{tall}, which four of them then do not fill; render with camera.window 0.5 or more."
            )

    @property
    def input_size(self) -> tuple[int, int]:
        """Width and height of what the network sees."""
        return self.input_width, self.input_height

    @property
    def window_size(self) -> tuple[int, int]:
        """Width and height of a picture to learn from."""
        return self.window_width or self.input_width, self.window_height or self.input_height

    @property
    def windows(self) -> bool:
        """Whether pictures to learn from are windows."""
        return self.window_size != self.input_size

    def scaled(self, scale: float) -> NetworkConfig:
        """The same network for pictures of another size.

        Raises:
            ConfigError: the sizes are no multiples of 32 any more.
        """
        if scale == 1:
            return self
        sides = ("input_width", "input_height", "window_width", "window_height")
        try:
            return replace(self, **{side: round(getattr(self, side) * scale) for side in sides})
        except ConfigError as error:
            raise ConfigError(f"with a stage's scale of {scale:g}, {error}") from error

    def model_config(self, catalogue: Catalogue) -> ModelConfig:
        """The network for the classes of a catalogue.

        Raises:
            DataError: objects without keypoints, or with different numbers of them.
        """
        counts = {o.name: 0 if o.keypoints is None else len(o.keypoints) for o in catalogue.objects.values()}
        if len(set(counts.values())) != 1 or 0 in counts.values():
            raise DataError(
                f"every object needs the same number of keypoints, but they have {counts}; "
                "write keypoints.json into the models folder."
            )
        keypoints = next(iter(counts.values()))
        return ModelConfig(len(counts), self.size, self.neck, keypoints, self.strides, self.bins, self.depthwise)


@dataclass(frozen=True)
class LossWeights:
    """Weights of the losses; the defaults are those of the paper."""

    box: float = 5.0
    """1 - IoU^2 of the amodal box."""
    likelihood: float = 5.0
    """Negative log likelihood of the keypoints under the coordinate classifier."""
    proxy: float = 10.0
    """1 - OKS of the regressed keypoints."""
    classes: float = 2.0
    """Varifocal loss of the class scores."""
    visibility: float = 1.0
    """Cross entropy of keypoint visibility."""
    rays: float = 0.0
    """Distance of the true 3-D keypoints to the rays of the predicted ones."""


@dataclass(frozen=True)
class StageConfig:
    """A part of the run with its own losses and learning rate (cosine from start to end)."""

    epochs: int
    """Passes over the data; 0 skips the stage."""
    learning_rate_start: float
    """At the stage's first step."""
    learning_rate_end: float
    """At its last step."""
    proxy_target: Literal["truth", "classifier"] = "classifier"
    """What the regressed keypoints follow: the labels, or the classifier where that is closer to the labels."""
    scale: float = 1.0
    """Size of the pictures of this stage, relative to that of the network. At half the size a picture takes well under
    half of the time."""
    warp: bool = True
    """Geometric augmentation and mosaic."""
    oks_sigma: float = 0.05
    """Tolerance of OKS, as a share of the instance's size. With a small one the class scores that an untrained network
    is asked for are nearly 0; a larger one in the first stage asks for more."""
    score_power: float = 0.5
    """The class score learns OKS to this power."""
    weights: LossWeights = field(default_factory=LossWeights)
    """Weights of the losses."""


@dataclass(frozen=True)
class StagesConfig:
    """The three stages of the paper; learning rates are for a batch of 8."""

    first: StageConfig = StageConfig(
        94, 1.25e-4, 6e-6, "truth", weights=LossWeights(likelihood=1.0, proxy=30.0, classes=1.0)
    )
    """2-D losses only; the proxy follows the labels."""
    second: StageConfig = StageConfig(96, 1.6e-5, 6e-6, "classifier")
    """The proxy follows the classifier's keypoints."""
    third: StageConfig = StageConfig(10, 6e-6, 6e-6, "classifier", warp=False, weights=LossWeights(rays=10.0))
    """No geometric augmentation; the 3-D loss joins."""

    def __post_init__(self) -> None:
        if self.epochs < 1 or min(stage.epochs for stage in self.all) < 0:
            raise ConfigError("the stages must have one epoch or more in all, and none a negative number.")
        if not all(0 < stage.oks_sigma < 1 for stage in self.all):
            raise ConfigError("oks_sigma lies between 0 and 1.")

    @property
    def all(self) -> tuple[StageConfig, StageConfig, StageConfig]:
        """In order."""
        return self.first, self.second, self.third

    @property
    def epochs(self) -> int:
        """Of the whole run."""
        return sum(stage.epochs for stage in self.all)

    def at(self, epoch: int) -> tuple[StageConfig, int]:
        """The stage an epoch belongs to, and that stage's first epoch."""
        first = 0
        for stage in self.all:
            if epoch < first + stage.epochs:
                return stage, first
            first += stage.epochs
        raise ValueError(f"epoch {epoch} lies after the last stage")


@dataclass(frozen=True)
class AugmentConfig:
    """Changes to the pictures. There is no flip: a mirrored rigid object is another object."""

    mosaic: float = 0.5
    """Probability of joining four whole pictures; windows are always joined."""
    rotate_deg: float = 10.0
    """Greatest turn of the picture in its plane, either way."""
    shift: float = 0.1
    """Greatest shift, as a share of the input's sides."""
    scale: tuple[float, float] = (0.75, 1.25)
    """Least and greatest zoom."""
    shear_deg: float = 2.0
    """Greatest shear."""
    hue: int = 5
    """Greatest change of hue, of OpenCV's 180 steps."""
    saturation: int = 30
    """Greatest change of saturation, of 255."""
    value: int = 30
    """Greatest change of brightness, of 255."""
    blur: float = 0.2
    """Probability of a blur."""
    noise: float = 0.2
    """Probability of sensor noise."""
    jpeg: float = 0.2
    """Probability of compression."""
    cutout: float = 0.3
    """Probability of patches that hide parts of the picture."""
    pasted: int = 0
    """Most objects of other pictures that are pasted into one, in another light; needs visible masks."""
    bare: float = 0.25
    """Probability that a window gives way to bare ground: a piece of it without objects, as large as the window.
    Windows always show objects, which the pictures that the network will see do not everywhere. Needs visible masks;
    only where pictures are windows."""
    backgrounds: Path | None = None
    """Folder of pictures put behind the objects of images with masks (for T-LESS's black ones)."""
    background: float = 0.5
    """Probability of such a background, where the folder is given."""


@dataclass(frozen=True)
class TrainConfig:
    """One training run."""

    output: Path = Path("runs/train")
    """Folder of the run: config.yaml, last/, best/, tensorboard/."""
    resume: bool = False
    """Continue the run in the output folder; where there is none, start it."""
    data: DataConfig = field(default_factory=DataConfig)
    """Pictures."""
    network: NetworkConfig = field(default_factory=NetworkConfig)
    """Network."""
    stages: StagesConfig = field(default_factory=StagesConfig)
    """Schedule."""
    augment: AugmentConfig = field(default_factory=AugmentConfig)
    """Augmentation."""
    batch_size: int = 8
    """Pictures per step and process."""
    warmup_steps: int = 1000
    """Steps of quadratic warm-up at the start of the run."""
    optimizer: OptimizerName = "adamw"
    """adamw, as RTMO; or muon: orthogonalised momentum for the kernels of convolutions, by the same learning rates."""
    weight_decay: float = 0.05
    """Never on biases and normalisations."""
    gradient_clip: float = 10.0
    """Greatest norm of the gradient."""
    ema_decay: float = 0.9998
    """Of the moving average of the weights, reached gradually."""
    shared_norms: bool = True
    """Normalise over the pictures of all processes together, so that P processes learn what one with P times the batch
    would. Costs a good half more time on CPUs."""
    least_positives: int = 1
    """Cells that learn each instance, at least."""
    minimum_visible: float = 0.1
    """Instances seen less are neither learnt nor counted as background."""
    validate_every: int = 5
    """Epochs between validations; the last epoch always ends with one."""
    initial: Path | None = None
    """What to begin with: a checkpoint of another training or an exported network, of other classes maybe (layers of
    other shapes, as those of the classes, begin as in any training), or a YOLOX of the same size as its authors publish
    it (yolox_nano.onnx)."""
    seed: int = 0
    """Of the first weights, the order and the augmentation."""
    precision: Literal["fp32", "bf16"] = "fp32"
    """Arithmetic of the network; losses and the coordinate classifier are always fp32."""
    device: Literal["auto", "cpu", "cuda"] = "auto"
    """auto takes a GPU if there is one."""
    workers: int = 1
    """Processes that load pictures; 0 loads in the training process."""
    threads: int = 0
    """Threads of PyTorch on the CPU; 0 leaves its own choice."""

    @property
    def needs_masks(self) -> bool:
        """Whether each picture must tell which object its pixels show."""
        return self.augment.pasted > 0 or (self.network.windows and self.augment.bare > 0)

    def __post_init__(self) -> None:
        if self.batch_size < 1 or self.workers < 0 or self.validate_every < 1 or self.least_positives < 1:
            raise ConfigError("batch_size, validate_every and least_positives start at 1, workers at 0.")
        if not 0 <= self.ema_decay < 1:
            raise ConfigError("ema_decay lies from 0 to below 1.")
        for stage in self.stages.all:
            self.network.scaled(stage.scale)
        *_, last = (stage for stage in self.stages.all if stage.epochs)
        if last.scale != 1:
            raise ConfigError(
                f"the last stage has a scale of {last.scale:g}; it must be 1, for the network will see pictures of its "
                "own input size."
            )
