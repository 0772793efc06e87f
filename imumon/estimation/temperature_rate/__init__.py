"""Temperature and its rate from a quantized thermometer, in real time; begin with `thermometer`.

Constants with the word ablation have rows of `scripts/reproduce/ablation --part temperature_rate`, in
docs/appendix/ablation-results.md.  Nothing is imported here, so that a device file can be read quickly.
"""
