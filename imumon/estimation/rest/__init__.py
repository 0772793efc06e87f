"""Is the unit at rest, and is a steady rate the bias or a turn?  Rest and bias are one estimator.

Read `slots` (quarters of a second), `quiet` (does anything move?) and `odds` (P(turn)); then of
`imumon.estimation.gyro_bias` `hypotheses` (the decision table) and `estimator`, which runs all slot by slot.

- Why is a slot no rest?  `Estimator.unrest`, from `QuietDetector.unrest` and P(turn).
- Why is sigma so wide?  `Estimator.output` sums its parts.
- What assumes MEMS gyros?  White noise and flicker are learned, whatever the gyro.  These are not, and no
  other values were tested: `quiet.QUIET_SD`, `odds.USUAL_CHANGE`, `odds.SLOWEST_TURN`, `odds.UNSEEN_TURN`;
  `SENSITIVITY_SD` and `TURN_ON` (bank), `SCALE_SD` (place), `BIAS_WALK` (motion); and the keys `gyro_drift`
  and `largest_jump`.  A better gyro thus takes turns below 22 °/h for bias, as any other does.
"""
