"""Wing: the methods of the papers, as they are printed; the defaults of the estimators are elsewhere.

- `fir`: temperature rate of Kozlov and Tarygin.
- `random_error`: stage with the filters of Shi Gang et al., `shi_filters`; they begin from `local_level`,
  which also has the means that they must beat.
- `dense_zupt`: ZUPT and TCZUPT of Fontanella et al.
- `self_alignment`: fixed-gain loop, total average and curve fit of Lee et al.

`imumon.run` has what the user calls them; `stages` makes them.
"""

from imumon.wing import Wing

WING = Wing(
    "papers",
    stages="imumon.papers.stages:published_stages",
)
