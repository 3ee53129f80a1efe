"""Values of a cause's parameters with intervals, from the curvature of the evidence."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.random_laws import of_variance
from orbitfb.diagnose.hypotheses.refit import summed
from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.diagnose.impact.pieces import Piece
from orbitfb.diagnose.likelihood.errors import variances
from orbitfb.diagnose.likelihood.weighed import Weighed
from orbitfb.diagnose.result.parts import ParameterValue
from orbitfb.effects.kinds import EffectKind, Parameter
from orbitfb.effects.laws import DeviceLaw, FieldLaw
from orbitfb.estimation.evidence import NormalTerms
from orbitfb.estimation.priors import KNOWN_TO, LEAST_SPREAD
from orbitfb.estimation.transform import Matrix

_NINETY = 1.645
"""Standard deviations of a normal number beyond which it is in one of ten cases, either side."""


_STEP = 0.02
"""Step of a value by which its derivative is taken, of the value [1]."""

_SHARES = np.geomspace(0.5, 2.0, 9)
"""Multiples of a scatter at which its evidence is taken for the interval: that of a hundred
devices is known to a tenth, that of ten to a third."""

Spread = Mapping[str, float]
"""Relative standard deviations by parameter; those that the record does not bear on are missing."""


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """Tells values with their intervals.

    Args:
        scorer: Of the record, all causes explained.
    """

    scorer: Scorer

    def values(
        self, kind: EffectKind, part: Candidate, pieces: tuple[Piece, ...]
    ) -> dict[str, ParameterValue]:
        """Tell the values of a cause: that its devices share, or of the largest one.

        Args:
            kind: The effect.
            part: The candidate that tells them, the first one of the cause.
            pieces: Values of its devices; what is left of others is told in later parts.
        """
        spread = self._spread(kind, part)
        shared = len(part.sources) == 1 and len(part.places) != 1
        told = dict(part.values) if part.scattered or shared else _largest(kind, pieces)
        record = self.scorer.space.signals.record
        return {
            parameter.name: _told(
                parameter, told[parameter.name], spread.get(parameter.name),
                kind.meaning(parameter, told[parameter.name], record), part.cycles is not None,
            )
            for parameter in kind.parameters
            if parameter.name in told
        }  # fmt: skip

    def _spread(self, kind: EffectKind, part: Candidate) -> Spread:
        if not kind.parameters:
            return {}
        if part.deviations:
            return part.deviations
        if part.raised:
            return self._of_scatter(kind, part)
        if part.columns:
            return self._of_columns(kind, part)
        if part.sources:
            return self._of_courses(kind, part)
        if part.walk is not None or part.white is not None:
            return self._of_variance(kind, part)
        if part.field is not None:
            return self._of_field(kind, part)
        return self._of_strikes(kind, part)

    def _of_courses(self, kind: EffectKind, part: Candidate) -> Spread:
        """Of the first device with values of its own; of all that share them.

        The freedom that they have from device to device is left out: it is what is asked for.
        """
        space, source = self.scorer.space, part.sources[0]
        # Currents that have the cause already have nothing of it left.
        signals = replace(space.signals, currents=space.signals.record.setpoints)
        most = space.courses.largest(kind) if len(kind.sizes) > 1 else {}
        columns = (*source.columns(kind, signals), *source.unset(kind, signals, most))
        fields = summed(columns, space.transform)
        shares = tuple(
            0.0 if block.accepted and block.law is source.law else share
            for block, share in zip(space.blocks, space.shares, strict=True)
        )
        return self._curved(fields, Weighed.of(replace(space, shares=shares)))

    def _curved(self, fields: Mapping[str, Matrix], weighed: Weighed | None = None) -> Spread:
        """Of relative changes that add fields, all of them free at once.

        A value of which the record says less than was known before has no interval.
        """
        if not fields:
            return {}
        _, information = (weighed or self.scorer).evaluate(list(fields.values()))
        covariance = np.linalg.inv(information + np.eye(len(fields)) / KNOWN_TO**2)
        variance = np.maximum(np.diag(covariance), 0.0)
        return {
            name: float(np.sqrt(one))
            for name, one in zip(fields, variance, strict=True)
            if one < 0.5 * KNOWN_TO**2
        }

    def _of_field(self, kind: EffectKind, part: Candidate) -> Spread:
        """Of a law of the whole ring, or of a pair: its size, and values by their derivatives."""
        space = self.scorer.space
        laws = [one for one in space.courses.laws(kind) if isinstance(one, FieldLaw)]
        field = np.asarray(part.field)
        if any(isinstance(one, DeviceLaw) and one.periodic for one in space.courses.laws(kind)):
            return self._of_line(kind, part)
        if not laws:
            fields = {p.name: field for p in kind.sizes}
            if len(fields) == 1:
                return self._curved(fields)
            size = self._curved({"size": field}).get("size", KNOWN_TO)
            return dict.fromkeys(fields, size)
        now = space.courses.field(laws[0], part.values)
        fields = {}
        for parameter in kind.fitted(space.signals.record):
            value = part.values.get(parameter.name, 0.0)
            if parameter.meanings or parameter.whole or value == 0.0:
                continue
            if parameter in kind.sizes and len(kind.sizes) == 1:
                fields[parameter.name] = field
                continue
            moved = {**part.values, parameter.name: value * (1.0 + _STEP)}
            slope = (space.courses.field(laws[0], moved) - now) / _STEP
            if np.any(slope):
                fields[parameter.name] = np.asarray(slope, dtype=np.float64)
        return self._curved(fields)

    def _of_line(self, kind: EffectKind, part: Candidate) -> Spread:
        """Of a wave at its first place: amplitudes, and the frequency by the phase at the ends."""
        space = self.scorer.space
        law = next(one for one in space.courses.laws(kind) if isinstance(one, DeviceLaw))
        place = list(part.places[:1])
        pattern = law.patterns[0][:, place]
        now = law.course(part.values, space.signals)[0]
        fields: dict[str, Matrix] = {}
        for parameter in kind.parameters:
            value = part.values.get(parameter.name, 0.0)
            if value == 0.0:
                continue
            step = _STEP
            if parameter.unit == "Hz":
                step = _STEP / max(abs(value) * float(space.signals.record.time[-1]), 1.0)
            moved = {**part.values, parameter.name: value * (1.0 + step)}
            slope = (law.course(moved, space.signals)[0] - now) / step
            own = slope if slope.shape[1] == 1 else slope[:, place]
            fields[parameter.name] = space.transform.spectrum(own) @ pattern.T
        return self._curved(fields)

    def _of_columns(self, kind: EffectKind, part: Candidate) -> Spread:
        """Of the device whose value is largest, all other errors free."""
        errors = self.scorer.errors
        mean = errors.mean()
        column = max(part.columns, key=lambda one: abs(mean[one]))
        used = list(errors.used)
        if column not in used or mean[column] == 0.0 or kind.linear is None:
            return {}
        scale = np.sqrt(errors.variance[used])
        inner = scale[:, None] * errors.information[np.ix_(used, used)] * scale
        inner[np.diag_indices_from(inner)] += 1.0
        unit = np.zeros(len(used))
        unit[used.index(column)] = scale[used.index(column)]
        variance = float(unit @ cho_solve(cho_factor(inner, lower=True), unit))
        return {kind.linear: float(np.sqrt(variance)) / abs(float(mean[column]))}

    def _of_scatter(self, kind: EffectKind, part: Candidate) -> Spread:
        """Of the standard deviation of all devices: where the evidence falls by 1.35 nats."""
        space, errors = self.scorer.space, self.scorer.errors
        number = next(iter(part.raised))
        evidence = []
        for share in _SHARES * space.shares[number]:
            shares = [*space.shares[:number], share, *space.shares[number + 1 :]]
            variance = np.maximum(variances(space.blocks, shares, len(space.terms)), space.single)
            evidence.append(NormalTerms(errors.pull, errors.information, variance).evidence())
        bend = np.polyfit(np.log(_SHARES), evidence, 2, w=np.exp(
            0.25 * (np.array(evidence) - max(evidence))))[0]  # fmt: skip
        spread = 1.0 / np.sqrt(2.0 * -bend) if bend < 0.0 else KNOWN_TO
        return {} if kind.linear is None else {kind.linear: float(min(spread, KNOWN_TO))}

    def _of_variance(self, kind: EffectKind, part: Candidate) -> Spread:
        """Of the size of something random: its information is that of its covariance."""
        _, information = of_variance(part, self.scorer.space)
        spread = 0.5 / np.sqrt(information + 0.25 / KNOWN_TO**2)
        return {kind.parameters[0].name: float(spread)}

    def _of_strikes(self, kind: EffectKind, part: Candidate) -> Spread:
        """Of what strikes now and then: as the count of strikes scatters."""
        first = kind.parameters[0].name
        probability = part.values.get(first, 0.0)
        space = self.scorer.space
        places = len(part.places) or len(space.signals.record.layout.bpms)
        strikes = probability * len(space.transform) * places
        if first != "probability" or strikes < 1.0:
            return {}
        return {p.name: 1.0 / float(np.sqrt(strikes)) for p in kind.parameters}


def _largest(kind: EffectKind, pieces: tuple[Piece, ...]) -> dict[str, float]:
    """The values of the device whose size is largest."""
    name = kind.linear
    if name is None:
        return dict(pieces[0].values)
    return dict(max(pieces, key=lambda one: abs(one.values.get(name, 0.0))).values)


def _told(
    parameter: Parameter, value: float, spread: float | None, meaning: str, wave: bool
) -> ParameterValue:
    """A value with its interval, within the bounds of its parameter."""
    least = 0.0 if wave and parameter.unit == "Hz" else LEAST_SPREAD
    reach = None
    if spread is not None and value != 0.0:  # a value of none was not sought
        reach = _NINETY * abs(value) * max(spread, least)
    return ParameterValue(
        value=value,
        low=None if reach is None else max(value - reach, parameter.low),
        high=None if reach is None else min(value + reach, parameter.high),
        unit=parameter.unit,
        at_bound=not parameter.meanings and value in (parameter.low, parameter.high),
        meaning=meaning,
    )
