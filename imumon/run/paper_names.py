"""Names of the published methods, as ``--published`` and the key ``published`` take them."""

from __future__ import annotations

from typing import Literal, get_args

PublishedMethod = Literal[
    "fir",
    "stf",
    "sr_ukf",
    "sr_rsukf",
    "dense_zupt",
    "dense_tczupt",
    "fixed_gain_loop",
    "total_average",
    "curve_fit",
]
PUBLISHED: tuple[PublishedMethod, ...] = get_args(PublishedMethod)
