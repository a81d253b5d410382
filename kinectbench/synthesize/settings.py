"""Settings of `synthesize`; defaults are the paper's where it says them."""

from typing import Annotated, Literal

from pydantic import Field, field_validator

from kinectbench.config import Settings, check_name

Layout = Literal["release", "recgan"]
Categories = Annotated[tuple[str, ...], Field(strict=False)]


class SynthesisSettings(Settings):
    """What to synthesise. Same settings and meshes, same bytes."""

    name: str = Field("synthetic", description="name of the benchmark")
    license: str = Field("unspecified", description="licence of the data, such as CC-BY-4.0")
    models: str | None = Field(None, description="folder of CAD meshes; default: parametric furniture")
    categories: Categories = Field((), description="only these; default: all there are")
    seed: int = Field(0, ge=0, le=10**9, description="draws the models of each split")
    train: int = Field(220, ge=0, le=100_000, description="training models per category (paper)")
    validation: int = Field(12, ge=0, le=100_000, description="validation models per category (paper)")
    test: int = Field(40, ge=0, le=100_000, description="test models per category (paper)")
    sv_steps: int = Field(5, ge=1, le=10, description="angles of roll, of pitch and of yaw, same viewing")
    cv_steps: int = Field(6, ge=1, le=10, description="the same, cross viewing")
    up: Literal["y", "z"] | None = Field(
        None,
        description="axis that points up; default: y in mesh files (ShapeNet), z in parametric furniture",
    )
    image_px: int = Field(320, ge=64, le=2048, description="width and height of the virtual depth image")
    max_faces: int = Field(1_000_000, ge=1, description="meshes with more are left out")
    min_containment: float = Field(0.85, ge=0, le=1, description="pairs below are refused")
    layout: Layout = Field("release", description="release, or recgan: the paper authors' files")

    _name = field_validator("name")(check_name)

    @field_validator("categories")
    @classmethod
    def _names(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        return tuple(check_name(name) for name in names)

    @property
    def up_axis(self) -> Literal["y", "z"]:
        """The axis of the models that points up."""
        return self.up or ("z" if self.models is None else "y")

    @property
    def wanted(self) -> dict[str, int]:
        """Split -> models per category, in the order in which they are dealt."""
        return {"train": self.train, "validation": self.validation, "test": self.test}
