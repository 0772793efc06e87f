"""The two clocks of a sample: `DeviceClock` unwraps what the device counts, `HostClock` maps it to Unix time.

::

    device = DeviceClock(decoder.timing)
    host = HostClock(device.drift_limit_ppm)
    device_time_ns, segment = device.process(packet_counter, device_ticks, arrival_ns, n)
    host_time_ns = host.process(device_time_ns, segment, arrival_ns)

Both go sample by sample, forwards only, so their results do not depend on how the stream was cut into blocks.
"""

from .device import DeviceClock
from .host import HostClock

__all__ = ["DeviceClock", "HostClock"]
