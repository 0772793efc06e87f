"""Is the unit at rest, and is a steady rate the bias or a turn?  Rest and bias are one estimator.

- A *slot* (`slots`) is a quarter of a second, or one slow sample: mean and variance of each axis.
- It is *quiet* (`quiet`) if means of slots differ by no more than noise and drift since the quiet began, and
  samples scatter no more than at rest.  Before a *trial* of 16 slots finds the noise, only given rest is.
- A *measurement* is the mean of a second of quiet slots; with it the filters of the bias are updated.
- The *present bias* has all measurements.  The *nominal bias* is a prediction as if nothing had changed: it
  has those of earlier rests and up to 16 to 32 s ago, but none of a rate that may be a turn.
- P(turn), by `odds`, is the probability that the present less the nominal bias is a turn.

Of `imumon.estimation.gyro_bias` read `hypotheses` (tables: what a measurement does to both biases),
`bank` (the Kalman filters) and `estimator`: slot by slot it calls these, `motion`, `place` and `thermal`.

- Why is a slot no rest?  `Estimator.unrest`, from `QuietDetector.unrest` and P(turn).
- Why is sigma so wide?  `Estimator.output` adds variances: of the filters, widened by gaps, temperature and
  turns against the earth; of flicker of samples; of the unknown earth rate; of a turn that may hide in the
  first rest; and of the difference to the less likely hypothesis, with the error by rounding (`stage`).
- What would another gyro need?  White noise is learned, flicker only among `FLICKER_CORNERS_S` (bank); else
  declare B and K; a far better one: QUIET_SD, SLOWEST_TURN, SENSITIVITY_SD, too.  "Ablation": docs/appendix.
"""
