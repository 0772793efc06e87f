"""Wing: the methods of the papers, as they are printed; the defaults of the estimators are elsewhere.

- `fir` (with `square_root`): temperature rate of Kozlov and Tarygin.
- `random_error`: stage with the filters of Shi Gang et al., `linear` (model L) and `sigma_points` (model NL);
  they begin from `local_level` and stand beside `rest_means`.
- `dense_zupt`: ZUPT and TCZUPT of Fontanella et al.
- `self_alignment`: fixed-gain loop, total average and curve fit of Lee et al.

`imumon.run.paper_names` has what the user calls them; `stages` makes them.
"""

from imumon.wing import Wing

WING = Wing(
    "papers",
    stages="imumon.papers.stages:published_stages",
)
