"""Bias over temperature: its curves, its model file, and its prediction live."""

from imumon.models.model import BiasModel, ChannelModel, load_model

__all__ = ["BiasModel", "ChannelModel", "load_model"]
