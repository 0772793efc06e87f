"""Temperature and its rate from a quantized sensor, in real time."""
