"""Every number that decides what is named, with its unit, its source, and what it changes."""

import numpy as np

# Noise, drift and healthy errors.

TRUST = (100.0, 300.0, 1000.0)
"""Steps that the prior shape of the walk may be worth: a record tells which, by what each half of
its frequencies says of the other. By hand: a factor of three apart; 100 rule modes that a record of
some hundred rows cannot show."""

LEAST_STEPS = 40
"""Steps below which walk and noise cannot be told apart: λ then has too few values."""

LARGEST = 36.0
"""Most that one body of a healthy ground moves, over an even share of all that moves [1]; of 1,800
bodies of the default ring 2 %. Chosen by hand between ground, whose largest body has a few even
shares, and a source at one place, which has nearly all; no command calibrates it yet."""

OCTAVES = 12
"""Octaves of frequency, from the fastest one on, in which the ground may walk more or less [1]:
those of a record of 4,000 rows. Slower than that it goes on as in the slowest of them."""

PER_OCTAVE = 0.7
"""Standard deviation of what the walk's ln(variance) changes from one octave to the next [1]: ln 2,
one power of the frequency. Motion of spectrum f⁻² becomes one of f⁻¹ or of f⁻³ (flicker)."""

OCTAVES_OF_NOISE = 6
"""Fastest octaves in which the walk does not rise with frequency [1]: a walk that does is hardly
told from noise of the readings, which rises with λ. Ground springs back over more rows. By hand."""

MOST_PER_OCTAVE = 1.4
"""Largest such change [1]: 2 ln 2, two powers of frequency. Motion of spectrum f⁻² becomes white
or one of f⁻⁴, as a temperature drifts."""

NEIGHBOURS = 3.0
"""BPMs over which the orbit of a place between two correctors is alike, in a ring without places
[1]. By hand."""

GIRDERS = (0.5, 1.0, 1.5, 2.0, 3.0, 4.5, 7.0)
"""Gaps at which a girder may end [m]: magnets of one stand closer. Each that parts the ring in
another way is tried. By hand: a factor of 1.5 or so, from magnets side by side to a straight."""

SLAB = 20.0
"""Distance over which neighbouring girders move together, on one slab of concrete [m]."""

SITE = 200.0
"""Distance over which the ground of a site moves together, as by temperature and tides [m]."""

BODY = 6
"""Quadrupoles in a row that may move as one body: a girder carries three to six of them."""

SHARES = (0.0, 0.1, 0.3, 1.0)
"""Shares of the healthy scatter that are tried: a record without errors must not pay for them."""

MATERIAL = 0.1
"""Rms of what a refinement of the model adds to a step, over that of the reading noise, from which
it is named: below it the one-step error changes by half a per cent, and nobody would act on it."""

LEAST_SHARE = 0.1
"""Least scatter of an accepted cause's values, of its limit: 5 %, as good as any value is known."""

LIMITS = (1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0)
"""Multiples of the usual healthy scatter that a healthy record may show: measured rings have gains
of 1 to 8 % and optics that beat by 1 to 10 %."""

AT_FIRST = 30
"""Rounds of the first fit of the floor's shapes, which begins with what raw readings make of them:
a shape that the ring does not have takes tens of them to fade. By hand."""

AGAIN = 12
"""Rounds by which the floor's shapes are fitted anew from where they stood: they were fitted
already, and a cause changes what is left little."""

TURNS = 3
"""Turns in which the ground's colour and its shapes are fitted one beside the other; the rounds
above are shared among them. By hand."""

FREELY = 8
"""Steps up the likelihood in which the walk may leave the shapes; chosen by hand: more hardly raise
it."""

EXACTLY = 0.02
"""Nats that the next step may still gain when the sizes of the healthy errors are sought: they are
compared by whole nats."""

MOST_STEPS = 12
"""Steps of that search at most: information by band is right to some per cent, where an excitation
is at a few frequencies to a fifth, and each step leaves less than that share of the last."""

WIDE = 10.0
"""How many times the healthy scatter the saturated model gives to every device: 10 % of gain, and
gradients that beat by 15 %, so that no linear law of any device can raise the floor."""


# What is searched, and what it costs.

SURE = 12.0
"""Log evidence [nats] above which a cause is accepted. Of records without a gap the best candidate
has 10.6 at most (`benchmarks.blind --suite healthy`: 448 small rings, `--many 201` to `216`, and 50
of the full ring, `--own 201` and `202`, `--first 25`; and ten of `--many 54`). But for one ring of
14 correctors and no table of places: what its quadrupoles do is not told by errors at these, and a
leak of 0.6 % between two of them has 28. And for three full rings that beat by more than is taken
for healthy (one of `--own 66 --first 25`): larger errors of all quadrupoles have 26, 17 and 12. Of
one small ring (`--many 214`) an unknown law has 15."""

VALUE_COST = 3.0
"""Nats that a law pays for its values: they are fitted, within a prior of about 20 widths of the
posterior (ln 20)."""

SIZE_WIDTH = 5.0
"""Standard deviation of a free size over the typical one of the effect."""

MOST_DEVICES = 24
"""Devices with a size of each one's own that a set may have before it is a scatter of all."""

WIDTHS = (0.5, 1.0, 2.0, 5.0)
"""Scatters of a size over the typical one that are tried where all devices have one of their
own. By hand: an octave apart."""

SCATTERED = tuple(np.geomspace(1.0 / 64.0, 8.0, 10))
"""The same where a law of many devices is linear. They are a factor of two apart, so that one is
right to √2, and a scatter that is off by as much costs 0.15 nats for each device."""

MORE = 3.0
"""Nats beyond its look-elsewhere cost that a further device of a set must bring."""

ONSET_SIGN = 8.0
"""Nats a²/2H of one device from which onsets of its law are looked for: a law that begins at the
middle of a record shows half of its final evidence in the whole of it."""

STANDING = 100.0
"""How many times larger than its motion in a record the orbit that stands in a magnet is [1]: some
tenths of a millimetre beside some micrometres. By hand: a factor of ten costs ln 10 nats."""

ROUNDS = 4
"""Causes that are accepted at most."""

AT_ONCE = 2
"""Different effects that a record may have at once. By hand: faults are rare and independent; one
that the library lacks is likelier than three at once."""

SCATTER = (2.0, 4.0, 8.0, 16.0, 32.0)
"""Multiples of the healthy scatter that are tried for all devices at once."""

FINALISTS = 10
"""Candidates that are evaluated exactly, and whose values are refined between those of the grid: a
scan leaves out what healthy errors of other devices hide, up to half of a large effect, and steps
of a grid that are 1.5 apart lose a tenth."""

LEADING = 4
"""Effects of a round that are weighed under floors of their own at most, and unknown laws that are
weighed beside all errors: each costs a second. By hand."""

CLOSE = 0.1
"""Share of the best evidence from which candidates are weighed under floors of their own [1]: under
one floor for all, what the floor stands in for makes most of a difference. By hand."""

MISFIT = 0.004
"""Share of the best evidence by which the evidences of models that are all a little wrong may
differ by chance [1]."""

ALONE = 0.1
"""Share of its evidence that an effect of few devices finds at most at all others, once these are
told, if it is no misfit of another law [1]. By hand: a misfit leaves them as much as it has."""

ANYTHING = 1e3
"""How many times the noise of the readings a device that may do anything moves the orbit [1]: far
more than a law that is nearly right leaves, and no more than what float32 bears."""

BENT = 1.0
"""Log likelihood by which what errors add together may be off before it is told anew [nats]: far
below what any decision hangs on."""

FIRST_ORDER = 0.02
"""Relative error of what healthy errors do to a record, where the ring's places are known [1]: it
is taken to be proportional to each of them, and they are errors of 1 to 2 %. Its square is the
share of their evidence that other laws may find."""

NEAREST = 0.05
"""The same where they are not [1]: gradient errors then stand at the correctors and are seen by the
nearest BPM, which leaves up to 5 % of what quadrupoles do to the response (`test_row_sums`)."""

RIVAL = 0.02
"""Probability from which another effect is told as one that the record cannot exclude [1]."""

UNLISTED = 0.25
"""Faults whose law is in no library, per one whose law is [1]. By hand: one fault in five."""

HIDDEN = 50.0
"""What an unlisted law leaves beside the effect that it looks like most, and nothing shows [nats],
besides `REMAINDER`. `benchmarks.blind` tells it of the records of a run. Of 26 of several runs
(`--own` 58 to 61, the last with `--leave-out`, `--plant` 1022 to 1024) it is 54 [17, 141]. Of small
rings it is 3,500 (`--many 54`, `--leave-out`): what is left out of the library there has a twin in
it, as a supply that trips has one that is limited."""

REMAINDER = 0.03
"""Share of the named causes' evidence from which what a free course finds beside them is told [1]:
a law that is right to a sixth of its amplitude leaves that."""

HOPE = 2.0
"""Log evidence [nats] of the best single device below which values are not looked at closely: the
best of 180 devices of a healthy record reaches 4."""

MOST_REFINED = 6
"""Devices of a set whose own values are searched between those of the grid when it is scanned; all
are once it has a floor of its own."""

STROKES = 0.05
"""Share of the rows in which single strokes are sought [1]: more of them are a walk."""

HEARD = 3
"""Times that the orbit is told anew from what BPMs make of it: a cubic error of a tenth is then
right to a thousandth. As often a law is told again over the floor that it leaves."""

SETTLED = 0.05
"""Share of what a cause does, weighed by the floor, by which it may still move when its sizes are
told [1]. By hand: a floor that was estimated with the cause in it takes part of it, the next one
less."""

FINENESS = 1.0 / 300.0
"""Share of the interval between two values of the grid to which the best one is found."""

NEARBY = 9
"""Values, from two below to two above the best of a grid, at which the devices that are struck are
sought again. By hand: half a step of the grid; a set that is sought with each has no single highest
value, so that all of them are tried. The value alone is then sought to FINENESS."""

FIRST_STATES = 5
"""States, from one end to the other, that a device that remembers may have had in the first row. By
hand: what is left between them is told by steps, and by finer levels (`NEARER_TURNS`). As many
values of its own are tried of each device."""

NEARER_TURNS = 6
"""Times that states are told more finely, at most: each halves the distance between levels."""

NEARER = 0.5
"""Evidence that this has to gain to be done again [nats]: less tells nothing."""

PARTNERS = 6
"""Devices with which the state of one is told together: those that act most like it. By hand."""

SLOPE = 0.02
"""Step by which derivatives are taken, of a state and of the logarithm of a value [1]."""

STEPS = (1.0, 0.5, 0.25)
"""Shares of a step of Gauss and Newton that are tried, until one is better [1]. By hand."""

WIDER = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0)
"""Factors of a value that was told with all states in the middle, at which states are sought. By
hand: with states in the middle a play of polled BPMs looked thirty times too narrow."""

GRID_REACH = 2
"""Values of the grid on either side within which the best one is searched: the best one for one
device at a grid's distance is the best one for all within two."""

STOOD_IN = 0.9
"""Squared cosine between what a law does and the healthy error of its device from which the error
stands in for it over a whole record [1]: it is 1 where their courses are the same."""

ONSETS_EVERY = 10
"""Rows between the onsets that are tried first."""

ONSET_MARGIN = 30
"""Rows at either end of a record within which no onset is tried: too few to tell it by."""

SWALLOWED = 2.0
"""Evidence of a cause over its own floor, over that beside a floor that has not left it yet: up to
such a factor a rival may still be the best, and its floor takes more turns. By hand, for time: a
factor of two is that of a floor which had half."""

UNTOLD = 3
"""First rows that a law which was always there may lose [rows]: the longest delay in ticks that is
usual. An onset within them is none."""

OWN_REACH = 0.25
"""Logarithm of the ratio within which a device's own value is searched: half a step of a grid."""

OWN_VALUES = 9
"""Values that are tried within that reach, a sixteenth apart, and then between the neighbours of
the best one."""

OWN_TURNS = 3
"""Times that they are: a value is then known to a hundredth of the distance of those in a grid."""

RANKED_VALUES = 2
"""Values of a grid that are scored for all sets of devices, by each of three marks. By hand: the
best one lies between two of them."""

SAMPLED = 12
"""Frequencies of a band that are summed where a value is only to be ranked among others: of the
slow bands, which have fewer, all. By hand: sums of most laws are then right to a fifth."""

VALUE_SCATTER = 0.5
"""Largest scatter of a value from device to device, of the value [1]: a half. Where values of every
device's own are told, it is that of their logarithms with which the search begins."""

STRUCK_SHARES = (0.003, 0.01, 0.03, 0.08, 0.2)
"""Shares of the rows that are struck."""

STRUCK_FINE = 20
"""Shares between the least and the largest of these that are weighed of what leads: a quarter from
one to the next, as 16 strikes tell."""

STRUCK_RUN = 5
"""Rows that are struck one after the other, at most: of 3,000 rows of which a fifth is struck one
run of that length is expected, ln 3,000 / ln 5."""

STRENGTHS = (2.0, 4.0, 8.0, 16.0)
"""Standard deviations of a stroke on single readings, over their noise."""

LINE_FINER = 2
"""Frequencies per that of the record's length, of the first look."""

LINE_FINEST = 16
"""Of the second look: the phase then turns by a tenth of a radian over the record at most."""

LINE_PERIODS = 6
"""Periods in the record from which a line is told from drift."""

LINE_VARIANCES = np.geomspace(1.0, 1e6, 13)
"""Prior variances of an amplitude that are tried, over what the noise leaves uncertain of it."""

LEVEL_WINDOWS = 24
"""Parts of the record of which the level is told."""

LEVEL_RATIOS = (0.4, 0.6, 0.75, 1.3, 1.6, 2.0, 2.5, 3.0, 4.0)
"""Ratios of the level at the end to that at the beginning."""

ANYWHERE = 6.0
"""Width of the logarithms of variances that noise may have [1]: a factor of twenty in rms."""

ODD = 8
"""Least BPMs per one whose noise is told as odd [1]: more of them are another make."""

RANDOM_VARIANCES = np.geomspace(1e-3, 1e4, 36)
"""Variances that are tried, in units of what the floor leaves uncertain of the pattern."""

UNSURE = (0.0, 0.1, 0.3, 1.0)
"""Shares of what the ground's walk along a pattern may be wrong by, which are free [1]."""

STROKE_PLACES = 4
"""Places whose strokes are sought one by one: those with the largest single one."""

FREE_LAGS = 5
"""Rows back to which a device's past acts freely: half a second at 10 Hz, longer than supplies and
BPMs of a slow feedback remember."""

FREE_MEMORIES = (10, 30, 100)
"""Rows over which what devices did before may fade [1]: longer than the lags above, and shorter
than a record. By hand; others lie between."""

FREE_WAVES = 2
"""Half waves over the record by which the size of a device may grow, fade and come back."""

FREE_BANDS = (4, 8, 16, 32, 64, 128, 256)
"""Frequencies of a band in which a place may kick more than the ground [1]: a wave alone has two or
three, and is in the library; of the widest a record has ten."""

FREE_WIDTHS = (0.01, 0.03, 0.1, 0.3, 1.0)
"""Standard deviations of the sizes that are tried, over what the device moves."""


# What the answer is called.

CERTAIN = 0.9
"""Probability of one effect alone from which it is named without an alternative."""

LEAST_SPREAD = 0.05
"""Least relative standard deviation of a value [1]: no law is right to better than that, as no
response is. With it 0.90 of 277 intervals have the truth, with 0.02 0.85 (`benchmarks.intervals
--first 101 --seeds 6`, but for curves of BPMs, quantisation, stuck correctors and lengthening:
their values were wrong otherwise). The frequency of a wave is right to better: it belongs to
nothing but time."""

BEND = 0.05
"""Relative change of a value by which the curvature of its evidence is taken [1]."""

KNOWN_TO = 1.0
"""Relative standard deviation of a value before the record is seen [1]."""

PROVED = 0.995
"""Of what repeats itself to the last bit [1]: one screen in two hundred had another reason."""

MOST_REPEATS = 0.75
"""Share of readings that repeat beyond which filling them in would be inventing a record [1]:
polled rings repeat 26 to 75 %."""

FOLLOWS = 0.98
"""Share of the variance of the requested changes that a linear law must explain [1]."""

SIGMAS = 5.0
"""Standard deviations from which a size counts as shown: by chance once in 3 million places."""

ALIKE = 0.98
"""Cosine from which two effects change the record alike: what one leaves of the other is a 25th
of its energy."""

ONCE_IN = 100.0
"""Records without a gap, of which one reaches the threshold at its best place: the evidence of
chance exceeds x with a probability of e^−x at most."""
