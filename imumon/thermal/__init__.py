"""Bias over temperature: its calibration, its curves, its model file, and its prediction live."""

from imumon.thermal.model import BiasModel, ChannelModel, load_model

__all__ = ["BiasModel", "ChannelModel", "load_model"]
