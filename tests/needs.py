"""What a few tests need and not every machine has: they are skipped with how to get it."""

from __future__ import annotations

import subprocess
import sys
from functools import cache

import pytest

COUNT_VULKAN_DEVICES = """
import ctypes
vulkan = ctypes.CDLL("libvulkan.so.1")
create_info = (ctypes.c_uint64 * 8)(1)  # VkInstanceCreateInfo: its type, all else zero
instance, count = ctypes.c_void_p(), ctypes.c_uint32()
if vulkan.vkCreateInstance(create_info, None, ctypes.byref(instance)) == 0:
    vulkan.vkEnumeratePhysicalDevices(instance, ctypes.byref(count), None)
print(count.value)
"""
"""A program of its own: a driver leaves threads and open files behind."""


@cache
def has_vulkan() -> bool:
    """Return whether a viewer without a window can draw here; on Linux it needs a Vulkan device."""
    if sys.platform != "linux":
        return True
    command = [sys.executable, "-c", COUNT_VULKAN_DEVICES]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return done.returncode == 0 and int(done.stdout) > 0


def need_vulkan() -> None:
    """Skip the test where no viewer can draw."""
    if not has_vulkan():
        pytest.skip("the viewer has no Vulkan driver here: sudo apt install mesa-vulkan-drivers libvulkan1")
