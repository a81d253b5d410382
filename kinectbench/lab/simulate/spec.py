"""Settings of a simulation, with defaults, ranges and units. The same spec gives the same bytes."""

from typing import Any, Literal, Self

import numpy as np
from pydantic import Field, SerializerFunctionWrapHandler, field_validator, model_serializer, model_validator

from kinectbench.core import listed
from kinectbench.core.geometry import Camera
from kinectbench.lab.simulate.writers import formats
from kinectbench.settings.base import Settings
from kinectbench.settings.words import near_miss

WorldFrame = Literal["upright", "first_camera", "random"]

FIRST_STAMP_NS = 1_400_000_000 * 10**9
# Each kind of random choice has its own stream, so that a new one does not change the rest.
SCENE, PATH, WORLD, SENSOR, DEVICE, FAULTS, GIVEN = range(7)
# Surfaces nearer than this give no depth, metres; the sensors' modules have the sources. An ideal sensor has
# no such limit, but is carried like a Kinect v1, so that recordings of both are comparable.
MIN_RANGE_M = {"kinect_v1": 0.4, "ideal": 0.4, "azure_kinect": 0.5, "phone_lidar": 0.2, "stereo": 0.195}
# Focal length in pixels, width and height of each sensor's own images. Azure Kinect: depth mode NFOV unbinned
# (Microsoft's hardware specification), with about the focal length of its factory calibrations. Phone:
# ARKit's depth image (Apple), 62 degrees across, like its wide camera in video. Stereo: a RealSense D435,
# 90 degrees across (Intel's datasheet).
NATIVE = {
    "kinect_v1": (525.0, 640, 480),
    "ideal": (525.0, 640, 480),
    "azure_kinect": (504.0, 640, 576),
    "phone_lidar": (212.0, 256, 192),
    "stereo": (424.0, 848, 480),
}
# Settings added after the first presets were frozen. At their defaults they are left out of a stored spec, so
# that the stored specs of older recordings, and their hashes, do not change.
LATER = {
    "order": "walk",
    "moves": "camera",
    "plate_m": 0.0,
    "reach_share": 0.04,
    "lowest_m": 0.25,
    "low_pass_share": 0.0,
    "low_pass_m": 0.25,
    "turn_rad": 0.0,
    "turn_rad_per_s": 2.6,
    "readout_s": 0.0,
    "masks": False,
    "stands_on": "floor",
    "color_rate_hz": None,
}


class GrownSettings(Settings):
    """Settings that are stored without those later added keys (`LATER`) that have their default value."""

    @model_serializer(mode="wrap")
    def _without_later_defaults(self, write: SerializerFunctionWrapHandler) -> dict[str, object]:
        values: dict[str, object] = write(self)
        return {key: value for key, value in values.items() if key not in LATER or value != LATER[key]}


class PathSettings(GrownSettings):
    """Motion of the camera around the object."""

    frames: int = Field(300, ge=1, le=100_000, description="number of frames")
    rate_hz: float = Field(30.0, ge=0.1, le=1000, description="frames per second")
    order: Literal["walk", "shuffled"] = Field(
        "walk", description="shuffled: views spread over the same arc and elevations, in no order of time"
    )
    moves: Literal["camera", "turntable", "hand"] = Field(
        "camera",
        description="turntable, hand: the camera stands still, and the object moves as if it did not",
    )
    plate_m: float = Field(0.0, ge=0, le=0.2, description="height of the turntable's plate; 0: without one")
    arc_rad: float = Field(2.2 * np.pi, ge=0, le=100, description="angle walked around the object")
    distance_m: float | None = Field(None, gt=0.2, le=10, description="to the object; default: it fits")
    reach_share: float = Field(
        0.04, ge=0, le=0.3, description="standard deviation of the distance, as a share of it"
    )
    lowest_m: float = Field(0.25, ge=0, le=2, description="the camera is held no lower above the floor")
    elevation_rad: float = Field(0.44, ge=-0.2, le=1.4, description="mean height of the camera as an angle")
    swing_rad: float = Field(0.33, ge=0, le=1, description="the elevation rises and falls by this")
    swings: float = Field(1.6, ge=0, le=100, description="how often it does over the recording")
    low_pass_share: float = Field(
        0.0, ge=0, le=1, description="of the way, at its end: the camera is carried low (walks only)"
    )
    low_pass_m: float = Field(0.25, ge=0.05, le=2, description="how high above the floor it is then")
    shake_m: float = Field(0.006, ge=0, le=0.2, description="standard deviation of the hand's shake")
    shake_rad: float = Field(0.008, ge=0, le=0.5, description="standard deviation of the hand's shake")
    speed_variation: float = Field(0.3, ge=0, le=0.9, description="the walking speed varies by this share")
    pause_s: float = Field(0.0, ge=0, le=1000, description="a pause, half-way, in which only the hand shakes")
    turn_rad: float = Field(
        0.0, ge=0, le=1.5, description="the camera rolls, pitches and yaws by this and back, again and again"
    )
    turn_rad_per_s: float = Field(2.6, gt=0, le=20, description="how fast such a turn is half-way")
    jolt_m: float = Field(0.0, ge=0, le=1, description="a sudden knock, at two thirds of the way")
    jolt_rad: float = Field(0.0, ge=0, le=1, description="turn that comes with the knock")


class SceneSettings(GrownSettings):
    """The surroundings of the object."""

    place: Literal["indoor", "outdoor"] = Field("indoor", description="outdoor: no walls, strong sun")
    walls: int | None = Field(None, ge=0, le=4, description="default: two or three, none outdoors")
    clutter: int | None = Field(None, ge=0, le=20, description="things around it; default: one or two")
    touching: bool = Field(False, description="a box stands against the object")
    stands_on: Literal["floor", "table"] = Field(
        "floor", description="table: the object and the clutter stand on one, above the floor"
    )


class SensorSettings(GrownSettings):
    """The sensor: its model, image size, depth errors, and the colour camera's exposure and timing."""

    model: Literal["kinect_v1", "ideal", "azure_kinect", "phone_lidar", "stereo"] = Field(
        "kinect_v1", description="ideal: exact depth and colour"
    )
    width: int = Field(640, ge=16, le=4096, description="of the images, pixels; default: the model's own")
    height: int = Field(480, ge=16, le=4096, description="of the images, pixels; default: the model's own")
    distortion: float = Field(1.0, ge=0, le=10, description="depth distortion, 1 = a typical device")
    sunlight: float | None = Field(None, ge=0, le=1, description="default: 0 indoors, 0.6 outdoors")
    exposure_s: float = Field(0.0, ge=0, le=0.2, description="of colour: motion blur")
    exposure_drift: float = Field(0.0, ge=0, le=0.9, description="automatic exposure varies by this share")
    readout_s: float = Field(
        0.0,
        ge=-0.2,
        le=0.2,
        description="a rolling shutter: from the first row to the last, depth and colour",
    )
    color_registered: bool = Field(True, description="colour is delivered in depth pixels")
    color_baseline_m: float = Field(0.025, ge=0, le=0.5, description="colour camera beside the depth camera")
    color_delay_s: float = Field(0.0, ge=-0.5, le=0.5, description="colour is taken this much after depth")
    color_rate_hz: float | None = Field(
        None, ge=0.1, le=1000, description="colour frames per second, if apart from depth's"
    )

    @model_validator(mode="before")
    @classmethod
    def _of_its_own_size(cls, values: Any) -> Any:
        """Fill in the sensor model's own image size where none is set."""
        model = values.get("model") if isinstance(values, dict) else None
        if not isinstance(model, str) or model not in NATIVE:
            return values
        _, width, height = NATIVE[model]
        return {"width": width, "height": height} | values


class FaultSettings(Settings):
    """Faults to put into the recording, for tests."""

    drop_share: float = Field(0.0, ge=0, le=0.9, description="share of frames that are missing")
    stamp_jitter_s: float = Field(0.0, ge=0, le=10, description="standard deviation of errors in the stamps")
    swapped_stamps: int = Field(0, ge=0, le=1000, description="neighbouring frames whose stamps are swapped")
    foreign_frames: int = Field(0, ge=0, le=1000, description="frames in the middle from another scene")
    jump_m: float = Field(0.0, ge=0, le=10, description="the given trajectory jumps by this, half-way")
    scale_error: float = Field(1.0, ge=0.1, le=10, description="recorded depth is multiplied by this")
    cut_share: float = Field(0.0, ge=0, le=0.99, description="this share of the last file or bag is missing")


class GivenSettings(GrownSettings):
    """The trajectory and the masks that the recording provides, and the errors of that trajectory."""

    trajectory: Literal["true", "noisy", "drifting", "none"] = Field("true", description="how good it is")
    noise_m: float = Field(0.005, ge=0, le=1, description="noisy: standard deviation per axis and frame")
    noise_rad: float = Field(0.002, ge=0, le=1, description="noisy: standard deviation per axis and frame")
    drift_m_per_m: float = Field(0.01, ge=0, le=1, description="drifting: error per metre of path")
    masks: bool = Field(False, description="true masks come with it, where the format has a place for them")


class SimulationSpec(Settings):
    """Settings of a simulation. The same spec gives the same bytes (one machine, pinned packages)."""

    object: str = Field("chair:seed=0", description="family and seed, such as chair:seed=3")
    mesh: str | None = Field(None, description="a mesh file in metres, instead of `object`")
    mesh_up: Literal["y", "z"] = Field("z", description="the axis of `mesh` that points up")
    seed: int = Field(0, ge=0, le=10**9, description="draws everything but the object")
    format: str = Field("tum", description="of the recording")
    world: WorldFrame = Field("upright", description="upright: z up, floor at 0; or first_camera, or random")
    path: PathSettings = PathSettings()
    scene: SceneSettings = SceneSettings()
    sensor: SensorSettings = SensorSettings()
    faults: FaultSettings = FaultSettings()
    given: GivenSettings = GivenSettings()
    save_depth: bool = Field(True, description="noise-free depth goes to the truth")

    @field_validator("format")
    @classmethod
    def _format_is_known(cls, name: str) -> str:
        """Refuse a format for which no writer is installed."""
        if name not in formats():
            hint = f"{near_miss(name, list(formats()))} choose one of {listed(formats())}".lstrip()
            raise ValueError(f"'{name}': unknown; {hint}")
        return name

    @model_validator(mode="after")
    def _masks_have_a_place(self) -> Self:
        """Refuse masks if the format cannot store them."""
        if self.given.masks and not formats()[self.format].masks:
            fit = ", ".join(name for name, one in formats().items() if one.masks)
            raise ValueError(f"given.masks needs one of the formats {fit}, not {self.format}")
        return self

    @model_validator(mode="after")
    def _blurs_only_what_moves(self) -> Self:
        """Refuse motion blur with a static camera: `expose` assumes that the whole scene moves as one."""
        if self.path.moves != "camera" and self.sensor.exposure_s > 0:
            raise ValueError(
                "sensor.exposure_s must be 0 unless path.moves is camera: it would blur what stands still"
            )
        return self

    @property
    def camera(self) -> Camera:
        """The depth camera: the sensor's focal length scaled to this width, the principal point centred."""
        width, height = self.sensor.width, self.sensor.height
        own_focal_px, own_width, _ = NATIVE[self.sensor.model]
        focal_px = own_focal_px * width / own_width
        return Camera(width, height, focal_px, focal_px, (width - 1) / 2, (height - 1) / 2)

    def rng(self, stream: int, index: int = 0) -> np.random.Generator:
        """Return an independent random generator for one purpose (`stream`) and one frame (`index`)."""
        return np.random.default_rng([self.seed, stream, index])

    def stamp_ns(self, index: int) -> int:
        """Return the true stamp of a frame in nanoseconds, rounded to microseconds."""
        return FIRST_STAMP_NS + round(index * 10**6 / self.path.rate_hz) * 1000
