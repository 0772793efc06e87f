"""The methods of the papers, as they are printed; the defaults of the estimators are elsewhere.

`fir` is the temperature rate of Kozlov and Tarygin, `random_error` the stage with the filters of Shi Gang et
al. (`linear`, `sigma_points`), `dense_zupt` the gyro bias of Fontanella et al., and `fixed_gain_loop` the
alignment of Lee et al.
"""
