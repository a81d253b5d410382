"""The devices, one file each, and the table that finds them by name."""

import importlib
from collections.abc import Iterator
from typing import NamedTuple

from kinectbench.core import CaptureError, SettingsError, missing_extra
from kinectbench.record.interface import Device, in_a_line, quiet

# name -> "module:class"; without --device the first device that is plugged in is used.
DEVICES: dict[str, str] = {
    "realsense": "kinectbench.record.devices.realsense:RealSense",
    "kinect": "kinectbench.record.devices.kinect:Kinect",
    "openni": "kinectbench.record.devices.openni:OpenNI",
    "azure": "kinectbench.record.devices.azure:AzureKinect",
    "orbbec": "kinectbench.record.devices.orbbec:Orbbec",
    "iphone": "kinectbench.record.devices.iphone:IPhone",
}


class ListedDevice(NamedTuple):
    """The facts about a device that are known without opening it.

    Attributes:
        name: the device's name for `--device`.
        cameras: the cameras that it supports.
        plugged_in: names of the cameras that are plugged in.
        absent: one line on what is not installed, and how to get it; "" if nothing is missing.
    """

    name: str
    cameras: str
    plugged_in: tuple[str, ...]
    absent: str


def device_of(name: str) -> Device:
    """Create the device with a name in DEVICES.

    Raises:
        SettingsError: there is no such device.
    """
    if name not in DEVICES:
        raise SettingsError(f"--device {name}: no such device; there are {', '.join(DEVICES)}")
    module, _, class_name = DEVICES[name].partition(":")
    device: Device = getattr(importlib.import_module(module), class_name)()
    return device


def listed_devices() -> Iterator[ListedDevice]:
    """Yield an entry for each device: its plugged-in cameras, or the packages that are not installed."""
    for name in DEVICES:
        device = device_of(name)
        absent, found = missing_extra(device.extra) or "", tuple[str, ...]()
        try:
            with quiet():
                found = () if absent else device.plugged_in()
        except Exception as error:  # libraries raise their own kinds
            absent = in_a_line(error)
        if absent and device.system:
            absent += f"; it needs {device.system}"
        yield ListedDevice(name, device.cameras, found, absent)


def device_to_use(name: str | None) -> Device:
    """Create the device with this name, or, without a name, the first that has a camera plugged in.

    Raises:
        SettingsError: there is no device of that name, or what it needs is not installed.
        CaptureError: no device is plugged in.
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
