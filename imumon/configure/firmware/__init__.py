"""Firmware of virtual devices: volatile settings, flash, and the answers to commands; one file per family."""
