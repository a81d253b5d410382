"""The devices, a file each, and the table by which one is found."""

import importlib
from collections.abc import Iterator
from typing import NamedTuple

from kinectbench.core.errors import CaptureError, SettingsError
from kinectbench.core.extras import missing_extra
from kinectbench.record.interface import Device
from kinectbench.record.quiet import in_a_line, quiet

# name -> "module:class"; without --device the first that is plugged in is taken.
DEVICES: dict[str, str] = {
    "realsense": "kinectbench.record.devices.realsense:RealSense",
    "kinect": "kinectbench.record.devices.kinect:Kinect",
    "openni": "kinectbench.record.devices.openni:OpenNI",
    "azure": "kinectbench.record.devices.azure:AzureKinect",
    "orbbec": "kinectbench.record.devices.orbbec:Orbbec",
    "iphone": "kinectbench.record.devices.iphone:IPhone",
}


class ListedDevice(NamedTuple):
    """What can be said of a device without opening it.

    Attributes:
        name: as `--device` has it.
        cameras: which it is for.
        plugged_in: names of the cameras that are plugged in.
        absent: one line on what is not installed, and how to get it; "" = nothing.
    """

    name: str
    cameras: str
    plugged_in: tuple[str, ...]
    absent: str


def device_of(name: str) -> Device:
    """The device of that name in DEVICES.

    Raises:
        SettingsError: there is none.
    """
    if name not in DEVICES:
        raise SettingsError(f"--device {name}: no such device; there are {', '.join(DEVICES)}")
    module, _, class_name = DEVICES[name].partition(":")
    device: Device = getattr(importlib.import_module(module), class_name)()
    return device


def listed_devices() -> Iterator[ListedDevice]:
    """Each device: what is plugged in, or what it lacks."""
    for name in DEVICES:
        device = device_of(name)
        absent, found = missing_extra(device.extra) or "", tuple[str, ...]()
        try:
            with quiet():
                found = () if absent else device.plugged_in()
        except Exception as error:  # its library lacks one of its own
            absent = in_a_line(error)
        if absent and device.system:
            absent += f"; it needs {device.system}"
        yield ListedDevice(name, device.cameras, found, absent)


def device_to_use(name: str | None) -> Device:
    """The device of that name, with all that it needs; or the first that is plugged in.

    Raises:
        SettingsError: there is none of that name, or what it needs is not installed.
        CaptureError: none is plugged in.
    """
    if name is not None:
        device = device_of(name)
        if missing := missing_extra(device.extra):
            raise SettingsError(f"--device {name}: {missing}")
        return device
    found = next((each.name for each in listed_devices() if each.plugged_in), None)
    if found is None:
        raise CaptureError("no camera is found; `kinectbench record --list` says what each needs")
    return device_of(found)
