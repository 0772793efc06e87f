"""The methods of the papers, as they are printed; the defaults of the estimators are elsewhere.

`fir` is the temperature rate of Kozlov and Tarygin, `linear` and `sigma_points` the random error of Shi Gang
et al., `dense_zupt` the gyro bias of Fontanella et al., `fixed_gain_loop` the alignment of Lee et al.
"""
