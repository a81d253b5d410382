"""Draw an individual sensor of the model that is set, and measure depth with it."""

from typing import TypeAlias

import numpy as np

from kinectbench.core.types import Float32
from kinectbench.lab.simulate.kinect import KinectUnit, draw_device, measured_depth
from kinectbench.lab.simulate.render import Rendering
from kinectbench.lab.simulate.spec import DEVICE, SimulationSpec
from kinectbench.lab.simulate.stereo import StereoUnit, draw_stereo, match_stereo
from kinectbench.lab.simulate.time_of_flight import (
    TimeOfFlightDevice,
    draw_time_of_flight,
    measure_time_of_flight,
)

SensorUnit: TypeAlias = KinectUnit | TimeOfFlightDevice | StereoUnit
# Sunlight on the scene, of 1 for full sun on a white surface: outdoors, as through thin cloud (chosen here).
SUNLIGHT = {"indoor": 0.0, "outdoor": 0.6}


def draw_sensor(spec: SimulationSpec) -> SensorUnit | None:
    """Draw the individual sensor, with the scene's sunlight; None for an ideal sensor."""
    sensor, camera, rng = spec.sensor, spec.camera, spec.rng(DEVICE)
    sunlight = SUNLIGHT[spec.scene.place] if sensor.sunlight is None else sensor.sunlight
    if sensor.model == "ideal":
        return None
    if sensor.model == "kinect_v1":
        return draw_device(camera, sensor.distortion, sunlight, rng)
    if sensor.model == "stereo":
        return draw_stereo(camera, sensor.distortion, sunlight, rng)
    return draw_time_of_flight(sensor.model, camera, sensor.distortion, sunlight, rng)


def measured(exact: Rendering, device: SensorUnit, spec: SimulationSpec, rng: np.random.Generator) -> Float32:
    """Return the device's depth image of a noise-free rendering: (height, width) metres, 0 = none."""
    if isinstance(device, KinectUnit):
        return measured_depth(exact, spec.camera, device, rng)
    if isinstance(device, StereoUnit):
        return match_stereo(exact, spec.camera, device, rng)
    return measure_time_of_flight(exact, spec.camera, device, rng)
