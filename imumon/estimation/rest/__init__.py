"""Is the unit at rest, and is a steady rate the bias or a turn?  Rest and bias are one estimator.

Read `slots` (quarters of a second), `quiet` (does anything move?) and `odds` (P(turn)); then of
`imumon.estimation.gyro_bias` `hypotheses` (the decision table), `bank` (the Kalman filters) and `estimator`.

- Why is a slot no rest?  `Estimator.unrest`, from `QuietDetector.unrest` and P(turn).
- Why is sigma so wide?  `Estimator.output` sums its parts.
- What would another gyro need?  White noise is learned, flicker only among `FLICKER_CORNERS_S` (bank); else
  declare B and K.  Assumed are `quiet.QUIET_SD`; `USUAL_CHANGE`, `SLOWEST_TURN` and `UNSEEN_TURN` of odds;
  `SLOPE_PER_SIGMA`, `SENSITIVITY_SD` and `TURN_ON` (bank); `SCALE_SD` (place); and `BIAS_WALK` (motion).
"""
