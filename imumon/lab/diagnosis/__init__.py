"""Find which effect a bias model lacks, from recordings of the unit at rest.

**Model.**  y is one axis of a sensor at rest, in SI units: means over n blocks (30 s), those of all training
runs one after another.  A run is a recording from power-on; runs are independent::

    y = X b + Z(theta) c + e,    e ~ N(0, sigma² V),    V = W + r F + q R                             (1)

    X (n, p)  the base: powers of u = (T - middle) / half span, T in °C, and constants of runs or poses
    Z (n, k)  columns of the effects; theta their time constants, widths and periods, which are not linear
    sigma     standard deviation of the white noise of a full block; V, r and q have no unit
    W (n, n)  white noise, diagonal: 1 over the share of its samples that a block has
    F (n, n)  flicker: mean of exp(-|ti - tj| / tau) over six tau, 30 to 10000 seconds; 0 between runs
    R (n, n)  random walk: min(ti, tj) / 7200 seconds, t since power-on; 0 between runs

t of F and R is the mean time of a block: that averaging smooths what is as fast as a block is neglected::

    2 loglik     = -n ln(RSS / n) - ln det V,    RSS = min over b, c of e' V^-1 e  (least squares)    (2)
    S(model)     = max over r, q of 2 loglik - (p + k + number of theta) ln n - 2 ln(choices)         (3)
    gain(effect) = S(model with effect) - S(model),    with it r + q is no larger than without        (4)
    bar          = 8 for an axis alone;  8 + 2 ln(families (2^m - 1)) for a family on any of m axes   (5)

S is the BIC with its sign turned.  `choices`, of an effect of a driver other than temperature, time and
specific force, is the number of such drivers times that of the kinds that have a driver; else 1.  The last
terms of (3) and (5) are those of the extended BIC (Chen & Chen 2008, doi:10.1093/biomet/asn034).  That of (5)
pays for a sum over the axes that show a family: by chance some always gain a little.  One alone pays nothing,
its false names are kept away by the verdict; live one pays for the families, as it is searched ever again.

A gain is nearly twice the logarithm of a Bayes factor: while nothing is missing, the probability that that
of one model ever exceeds g is about exp(-g / 2) at most, however often tested (Ville 1939; Shafer et al.
2011, doi:10.1214/10-STS347).  Of the best of k models it is k times that: the prices of theta and of a choice
are for this.  (4) is that of all trials; for a drop, and between bases, S alone counts, any r and q.

**Search** (`search`), stepwise over all axes of a sensor, which share one physics.  1 to 4 are a stage:

1. *Try.*  Each axis tries every candidate beside what it has, with theta of a grid; at first in pairs, too,
   as two effects may hide one another.
2. *Choose.*  An axis *shows* a family whose gain there is above 0, of an event above 8, and not below the
   best by the bar or 15 %, whichever is more.  The family is chosen whose gain, summed over the axes that
   show it, is largest, if that exceeds the bar.  Of those less than 10 or 15 % below any other goes before an
   event; the rest are alternatives.
3. *Add.*  Each of these axes refines theta, adds it, and refines all its effects again.  It refuses what
   takes away less than 0.3 white floors or 0.2 of what a former one does, and a second event of a family in
   a run.
4. The axes that are left choose again, each without what it has refused, until no family exceeds the bar.
   Axes to which nothing was added are finished; the others begin another stage.
5. *Drop.*  After the last stage each axis drops what the rest makes needless, takes alternatives that are
   likelier beside it, and refines.  Effects of the present model: before the first stage those worth 8 or
   less stay as they are, the others are refined.

**Verdict** (`claims`, `verdict`): of what was found, that is claimed which explains training and the test, if
any.  It is fitted by ordinary least squares; of a test, what carries over is predicted, the rest estimated.
Fit and test are in blocks of 30 s, the search and the sigmas, of its noise, in shorter ones where these are
few: y, n, u and the white floor are then others.

**Words.** *Slot*: a second of samples, or the period of a slower log; a *block* has the mean of its slots at
rest. *Channel*: an axis, or another column. *Driver*: what an effect depends on, the temperature or another
column. *Pose*: a stretch in one attitude. *Event*: has a time of its own in one run, as a jump. *Late*:
behind its driver by a lag or delay. *Free start*: the state at power-on is fitted, too. *Kind*: a class of
effects. *Family*: those of one kind and driver. *Candidate*: what may be added. *Finding*: what the search
added, or kept of the present model. *Claim*: a new effect that training and test bear out, or the test alone.
*White floor*: sd of a block's mean by white noise, the unit of sizes; *total floor*: with the rounding of
coarse samples. *Present model*: the one that the unit has already, if any; else a polynomial is *declared*.
Coefficients that are *shared* are one for all runs and carry over to others, *separate* ones are a run's own.
An effect by which the rms of the residual falls from A to B *takes away* sqrt(A² - B²).

**Read** runs, prepare, blocks (recordings to y); candidates (X, Z); likelihood (2, by 6 to 8); search (3 to
5); fit (with sigmas, 9); claims (10), verdict; diagnose, the caller; report, page, extended, planning, live.
"""
