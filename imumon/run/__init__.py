"""Runs of the pipeline: live from a port, again from a recording, once over a file.

Here are the names of the published methods, to load quickly.
"""

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
"""As ``--published`` and the key ``published`` take them."""
