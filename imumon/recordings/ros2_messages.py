"""The fields of the ROS 2 messages that are written, as a reader without ROS needs them in the file.

Names, types and their order are those of common_interfaces (sensor_msgs, geometry_msgs, std_msgs,
diagnostic_msgs) and builtin_interfaces since ROS 2 Foxy; CDR holds nothing but the values in this order.
"""

from __future__ import annotations

_PARTS = {
    "std_msgs/Header": ("builtin_interfaces/Time stamp", "string frame_id"),
    "builtin_interfaces/Time": ("int32 sec", "uint32 nanosec"),
    "geometry_msgs/Quaternion": ("float64 x", "float64 y", "float64 z", "float64 w"),
    "geometry_msgs/Vector3": ("float64 x", "float64 y", "float64 z"),
    "sensor_msgs/NavSatStatus": ("int8 status", "uint16 service"),
    "diagnostic_msgs/DiagnosticStatus": (
        "byte level", "string name", "string message", "string hardware_id",
        "diagnostic_msgs/KeyValue[] values",
    ),
    "diagnostic_msgs/KeyValue": ("string key", "string value"),
}  # fmt: skip
_MESSAGES = {
    "sensor_msgs/Imu": (
        "geometry_msgs/Quaternion orientation", "float64[9] orientation_covariance",
        "geometry_msgs/Vector3 angular_velocity", "float64[9] angular_velocity_covariance",
        "geometry_msgs/Vector3 linear_acceleration", "float64[9] linear_acceleration_covariance",
    ),
    "sensor_msgs/MagneticField": (
        "geometry_msgs/Vector3 magnetic_field", "float64[9] magnetic_field_covariance",
    ),
    "sensor_msgs/Temperature": ("float64 temperature", "float64 variance"),
    "sensor_msgs/FluidPressure": ("float64 fluid_pressure", "float64 variance"),
    "sensor_msgs/NavSatFix": (
        "sensor_msgs/NavSatStatus status", "float64 latitude", "float64 longitude", "float64 altitude",
        "float64[9] position_covariance", "uint8 position_covariance_type",
    ),
    "diagnostic_msgs/DiagnosticArray": ("diagnostic_msgs/DiagnosticStatus[] status",),
}  # fmt: skip
_RULE = "=" * 80


def _definition(fields: tuple[str, ...]) -> str:
    """Return a message with all that it is made of."""
    fields = ("std_msgs/Header header", *fields)
    texts, needed, done = ["\n".join(fields)], list(fields), set[str]()
    while needed:
        kind = needed.pop(0).split()[0].partition("[")[0]
        if kind in _PARTS and kind not in done:
            done.add(kind)
            texts.append(f"{_RULE}\nMSG: {kind}\n" + "\n".join(_PARTS[kind]))
            needed += _PARTS[kind]
    return "\n".join(texts)


DEFINITIONS = {name.replace("/", "/msg/"): _definition(fields) for name, fields in _MESSAGES.items()}
"""Of each message, by its full name, with the parts it is made of."""
