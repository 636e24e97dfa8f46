"""Numbers that the whole package shares: tolerances of arithmetic, and limits of what is read."""

# What is equal in exact arithmetic is equal within this share: sums of times and commands, and the
# ends of iterations that converge quadratically. Halved or doubled, nothing changes.
ROUNDING = 1e-9
# A direction with a singular value below this share of the largest (its information is the square)
# is none: what is known of it is rounding of sums over a record. Ten times as large, directions
# that runs hardly show count as unknown.
RANK_TOLERANCE = 1e-6
# Step of a difference quotient, in typical sizes: near the cube root of the precision of numbers,
# where truncation and rounding of a central difference are equally small.
DIFFERENCE_STEP = 1e-5
# Standard deviations that normal noise passes once in 16,000 samples, and what a fit warns of in as
# many questions.
BEYOND = 4.0
# A part matters that is this share of the whole: of noise, of a misfit, of a statistic, of an
# interval or of the time between samples. And one that does not: of noise, of a statistic, of a
# range, of a speed, or of that time (two samples are of one moment).
MATERIAL, IMMATERIAL = 0.3, 0.1
# A hundredth that nobody would miss: of a signal, of the width of a limit, of noise or a criterion;
# and of a nat, within which likelihoods are of one optimum.
NEGLIGIBLE = 0.01
# Numbers that agree to three digits are the same to whoever reads them: an iteration that converges
# slowly ends there, in standard errors, two directions are one, and a change so small is a slope.
THREE_DIGITS = 1e-3
# Twice the logarithm of the odds, 20 to 1, from which one explanation is told from another. Halved
# it is 4 to 1, doubled 400 to 1.
TOLD_APART = 6.0
# No state is this many times its scale, or its SI unit where the scale is smaller (times since 1970
# are 1e9), nor a sensitivity this many times the noise: it has run away, although it is a number.
RUNAWAY = 1e12
# Bytes of a line, a datagram or an expression: longer ones are not what a person or a logger wrote.
LONGEST_LINE = 1 << 16
# Of one table or log: more than fits into the memory of most computers.
TABLE_BYTES = 4 * 1024**3
# Seconds after which whoever waits is told how far it is, and for which a process that was stopped
# is waited for before it is killed.
PATIENCE = 2.0
