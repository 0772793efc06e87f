"""Find which effect a bias model lacks, from recordings of the unit at rest.

**Model.**  y is one axis of a sensor at rest, in SI units: means over n blocks (30 s), those of all training
runs one after another.  A run is a recording from power-on; runs are independent::

    y = X b + Z(theta) c + e,    e ~ N(0, s² V),    V = W + r F + q R                                (1)

    X (n, p)  the declared model: powers of u = (T - middle) / half span, and constants of runs or poses
    Z (n, k)  columns of the effects; theta their time constants, widths and periods, which are not linear
    W (n, n)  white noise: variance of a block's mean over that of a full block, diagonal
    F, R      flicker, mean over tau of exp(-|ti - tj| / tau); random walk, min(ti, tj) / 2 h; 0 between runs

    2 ln p(y)   = -n ln(RSS / n) - ln det V,    RSS = min over b, c of e' V^-1 e  (least squares)     (2)
    S(model)    = max over r, q of 2 ln p - (p + k + number of theta) ln n - choice                  (3)
    gain(f | M) = S(M + f) - S(M),    where beside f the noise r + q is no larger than beside M       (4)
    bar         = 8 for an axis alone;  8 + 2 ln(f (2^m - 1)) for one of f families on any of m axes  (5)

S is the BIC with its sign turned; the last terms of (3), for a choice among other drivers than temperature,
and of (5) are those of the extended BIC (Chen & Chen 2008, doi:10.1093/biomet/asn034).  A gain is twice the
logarithm of a Bayes factor: while nothing is missing it ever exceeds g with a probability of exp(-g / 2) at
most, however often it is tested (Ville 1939; Shafer et al. 2011, doi:10.1214/10-STS347).

**Search** (`search`), stepwise over all axes of a sensor, which share one physics:

1. each axis tries every candidate (a family with a theta of its grid), at first in pairs as well;
2. the family is chosen whose gain, summed over the axes that show it, is largest and exceeds the bar;
3. each of these axes refines theta and adds it, unless it takes away too little;
4. the axes that are left choose again; then 1 to 3 are repeated until no family exceeds the bar;
5. backwards, each axis drops what it does not need beside the rest, and refines the rest.

**Verdict** (`verdict`): of what was found, that is claimed which explains training and the test, if any.

**Words.**  *Base*: X.  *Family*: effects of one name.  *Candidate*: what may be added.  *Finding*: what the
search added.  *Claim*: a finding that training and test bear out.  *Floor*: sd of a block's mean by white
noise, the unit of all sizes; *total floor*: with the rounding of coarse samples.  *Present model*: the one
that the unit has already, when there is one.  *Shared* coefficients are one for all runs and carry over to
others, *separate* ones are a run's own.

**Read** runs, prepare, blocks (recordings to y); candidates (X, Z); likelihood (1, 2); search (3 to 5); fit,
verdict; diagnose, which calls them all; then what is made of it: report, page, extended, planning, live.
"""
