"""The settings of a method: its network, its loss, and how it is trained. A configuration is a YAML file."""

import re
from pathlib import Path
from typing import Annotated, Literal, Self

import yaml
from pydantic import Field, field_validator, model_validator

from kinectbench.core import (
    SettingsError,
    canonical_json,
    category_problem,
    name_problem,
    printable,
    sha256_text,
)
from kinectbench.settings.base import Settings
from kinectbench.settings.overrides import read_model
from kinectbench.settings.words import suggestion

NetworkName = Literal["3d-recgan++", "3d-recae", "3d-epn", "varley", "han-like"]
# Kind of a user's own network: a class by its path.
OWN = "own"
CLASS_PATH = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*:[A-Za-z_]\w*", re.ASCII)
# Networks with the generator's encoder and decoder: only they have a choice of widths and sides.
GENERATORS = ("3d-recgan++", "3d-recae")


class NetworkSettings(Settings):
    """Which network is used, and how many channels and output cells it has."""

    kind: Literal[NetworkName, "own"] = Field(
        description="the network, by its name in the paper; own: the user's class `class_path`"
    )
    class_path: str | None = Field(
        None, description="for kind own: `package.module:Class`, an installed subclass of `Network`"
    )
    channel_divisor: int = Field(
        1, ge=1, le=64, description="numbers of hidden channels are divided by it; 1: the published size"
    )
    output_cells: Literal[64, 128, 256] = Field(
        256, description="3d-recgan++ and 3d-recae: cells along a side of the output (paper: 256)"
    )
    axes: Literal["kinectbench", "recgan"] = Field(
        "kinectbench",
        description="axes of the grids; recgan: x to the left and y up, as in the authors' files",
    )
    initial_weights: Literal["xavier", "he"] = Field(
        "xavier", description="xavier: as in the authors' code; he: He-normal, which keeps the variance"
    )

    @model_validator(mode="after")
    def _of_generators(self) -> Self:
        for name in ("output_cells", "initial_weights") if self.kind not in GENERATORS else ():
            if getattr(self, name) != type(self).model_fields[name].default:
                raise ValueError(f"{name} cannot be chosen for {self.kind}: leave it out")
        return self

    @model_validator(mode="after")
    def _of_own(self) -> Self:
        if (self.kind == OWN) != (self.class_path is not None):
            raise ValueError("class_path belongs to kind: own, and own needs it")
        if self.class_path is not None and not CLASS_PATH.fullmatch(self.class_path):
            raise ValueError("class_path must be like package.module:Class")
        return self


class LossSettings(Settings):
    """How the loss of each voxel is computed and weighted, and which voxels it counts."""

    kind: Literal["cross-entropy", "weighted-cross-entropy"] = Field(
        "weighted-cross-entropy", description="loss of a voxel; weighted: by alpha"
    )
    alpha: float = Field(
        0.85, gt=0, lt=1, description="weight of occupied voxels, 1 - alpha of empty ones (paper: 0.85)"
    )
    probability_floor: float = Field(
        0.0, ge=0, lt=0.5, description="smaller predictions are clamped to it, and have no gradient"
    )
    unknown: Literal["count", "mask"] = Field(
        "count", description="voxels of unknown truth; count: by their published value; mask: left out"
    )
    tile_cells: Literal[32, 64, 128] | None = Field(
        None,
        description="3d-recae beyond 64^3: side, in cells, of the random tile on which a step computes the "
        "loss of a pair; default: the whole output",
    )

    @model_validator(mode="after")
    def _weights(self) -> Self:
        for name in ("alpha", "probability_floor") if self.kind == "cross-entropy" else ():
            if getattr(self, name) != type(self).model_fields[name].default:
                raise ValueError(f"{name} belongs to weighted-cross-entropy: leave it out")
        return self


class AdversarialSettings(Settings):
    """Loss and learning rate of the discriminator, and its weight; only for 3d-recgan++."""

    beta: float = Field(
        ge=0, le=1, description="weight of the reconstruction loss; the discriminator's weight is 1 - beta"
    )
    loss_scale: float = Field(1.0, gt=0, description="factor on the generator's loss")
    gradient_penalty: float = Field(10.0, ge=0, description="lambda of WGAN-GP (paper: 10)")
    epsilon: Literal["voxel", "sample"] = Field(
        "sample",
        description="whether each voxel or each sample gets its own random mixture of truth and "
        "prediction for the gradient penalty",
    )
    penalty_on: Literal["mean", "sum"] = Field(
        "mean", description="penalise the gradient of the features' mean, or of their sum (authors' code)"
    )
    learning_rate: float = Field(
        5e-5, gt=0, le=1, description="learning rate of the discriminator (paper: 5e-5)"
    )


class TrainingSettings(Settings):
    """How long, on which pairs and at what learning rate a network is trained and validated."""

    batch: int = Field(4, ge=1, le=4096, description="number of pairs in a step")
    epochs: float = Field(
        10, gt=0, le=100_000, description="how often each pair is used; 0.5: half of the pairs, once"
    )
    learning_rate: float = Field(1e-4, gt=0, le=1, description="initial learning rate of Adam")
    halve_every_epochs: int | None = Field(
        None, ge=1, description="number of epochs after which the learning rate is halved, repeatedly"
    )
    schedule: Literal["constant", "cosine"] = Field(
        "constant", description="cosine: the learning rate falls to 0 along half a cosine"
    )
    seed: int = Field(
        0,
        ge=0,
        le=2**31,
        description="seed of the initial weights, the order of pairs and all random choices",
    )
    precision: Literal["float32", "bfloat16"] = Field(
        "float32", description="dtype of convolutions and matrix products; losses are float32"
    )
    validate_every_steps: int = Field(500, ge=1, description="number of steps between two validations")
    validation_pairs: int = Field(
        20, ge=0, description="number of validation pairs, evenly spread over the split; 0: no validation"
    )
    leave_out: Annotated[tuple[str, ...], Field(strict=False)] = Field(
        (), description="objects of the training split that are not trained on, such as test objects"
    )
    category: str | None = Field(
        None, description="the only category that is trained and validated on; default: all"
    )
    keep: Literal["last", "best"] = Field(
        "last", description="the weights to keep: of the last step, or of the best validation IoU"
    )


class MethodSettings(Settings):
    """A whole configuration: the method's name, and its network, loss and training."""

    name: str = Field(description="name of the method, and of the folder of its predictions")
    network: NetworkSettings
    loss: LossSettings = LossSettings()
    adversarial: AdversarialSettings | None = Field(
        None, description="3d-recgan++ only, which cannot be trained without it"
    )
    training: TrainingSettings = TrainingSettings()

    def of_category(self, category: str) -> "MethodSettings":
        """Return these settings for pairs of one category only; the category is added to the method's name.

        Raises:
            SettingsError: the category's name cannot be part of a method's name.
        """
        if problem := category_problem(category):
            raise SettingsError(f"--category '{printable(category)}': {problem}")
        named = self.name if self.training.category == category else f"{self.name}-{category}"
        training = self.training.model_copy(update={"category": category})
        return self.model_copy(update={"name": named, "training": training})

    @field_validator("name")
    @classmethod
    def _name(cls, value: str) -> str:
        if problem := name_problem(value, also="+"):
            raise ValueError(problem)
        return value

    @model_validator(mode="after")
    def _adversarial(self) -> Self:
        if (self.network.kind == "3d-recgan++") != (self.adversarial is not None):
            raise ValueError("adversarial belongs to 3d-recgan++, and 3d-recgan++ needs it")
        return self

    @model_validator(mode="after")
    def _tiles(self) -> Self:
        tile, network = self.loss.tile_cells, self.network
        if tile and (network.kind != "3d-recae" or network.output_cells == 64):
            raise ValueError("loss.tile_cells belongs to 3d-recae with output_cells 128 or 256")
        if tile and tile >= network.output_cells:
            raise ValueError("loss.tile_cells is as large as the output: leave it out")
        return self

    @property
    def sha256(self) -> str:
        """Return the hash of the values that differ from defaults; new settings do not change old hashes."""
        return sha256_text(canonical_json(self.model_dump(mode="json", exclude_defaults=True)))


FOLDER = Path(__file__).parent / "configs"
SUFFIX = ".yaml"


def packaged_configs() -> tuple[str, ...]:
    """Return the names of the configurations in the package, sorted."""
    return tuple(sorted(path.stem for path in FOLDER.glob(f"*{SUFFIX}")))


def find_config(name: str) -> MethodSettings:
    """Read a configuration by its name in the package, or by its path.

    Raises:
        SettingsError: there is no such configuration, or both the package and a file have this name; or the
            configuration has errors, one line each.
    """
    path = Path(name)
    if name in packaged_configs():
        if path.is_file():
            raise SettingsError(
                f"{name}: both a packaged configuration and a file; for the file write ./{name}"
            )
        return read_config(FOLDER / f"{name}{SUFFIX}")
    if not path.is_file():
        shown = printable(name)
        raise SettingsError(
            f"{shown}: no such file, and no configuration of ours; {suggestion(name, packaged_configs())}"
        )
    return read_config(path)


def read_config(path: Path) -> MethodSettings:
    """Read and check a configuration.

    Raises:
        SettingsError: the file cannot be read, or has errors: one line each, with file and line, key, and
            what is allowed.
    """
    return read_model(path, MethodSettings, "name: my-method")


def write_config(config: MethodSettings, path: Path) -> None:
    """Write a configuration, defaults included, in a form that older versions of `read_config` read too."""
    values = config.model_dump(mode="json")
    if config.training.category is None:
        del values["training"]["category"]
    text = yaml.safe_dump(values, sort_keys=False, allow_unicode=True)
    path.write_text(text, encoding="utf-8")
