"""Put the parts of an answer together."""

from collections.abc import Sequence
from dataclasses import dataclass

from orbitfb.diagnose.ambiguity import identifiability
from orbitfb.diagnose.answer import Diagnosis
from orbitfb.diagnose.answer_blocks import AmbiguousSet
from orbitfb.diagnose.answer_parts import Experiment, Gap, NotTested, Provenance, Shrink
from orbitfb.diagnose.answering import named_causes, tournament_rows
from orbitfb.diagnose.certain import Certain
from orbitfb.diagnose.closed_loop import closed_loop
from orbitfb.diagnose.contrast import Contrast
from orbitfb.diagnose.detectable import detectable
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.fingerprints import fingerprints
from orbitfb.diagnose.gap import gap, surplus
from orbitfb.diagnose.gap_maps import lag_profile, maps
from orbitfb.diagnose.judgement import Judgement, held_to_account, too_little
from orbitfb.diagnose.naming import geometry
from orbitfb.diagnose.net_competitor import fitted_net
from orbitfb.diagnose.plan import plan
from orbitfb.diagnose.score_map import score_map
from orbitfb.diagnose.search import Outcome
from orbitfb.diagnose.shrink import contrast, k_steps, shrink
from orbitfb.diagnose.unseen import Unseen
from orbitfb.diagnose.wording import headline
from orbitfb.diagnose.worth import Gains, Worths, waterfall
from orbitfb.effects.kinds import EffectKind
from orbitfb.effects.random_kinds import LatentKind, NoiseKind
from orbitfb.records.record import Record

_RIVALS = 4
_PLANNED = 3
"""Rivals at most from which an experiment has to split the best cause."""
_FAINT = "what speaks for an effect is short of a certainty of 0.99"
_HEALTHY = 10.0
"""What causes leave of a gap on later data, beyond what healthy errors may have made there, up to
which it does not speak against them [nats]."""
_MORE = "a longer record, or the recommended experiment"


@dataclass(frozen=True, slots=True, eq=False)
class Parts:
    """What an answer is made of.

    Args:
        outcome: Of the search.
        judged: Its state.
        later: Used neither for fitting nor for selection; None if there is nothing.
        told: Whether `later` is a record of its own.
        kinds: That were tested.
        seed: Of the bootstrap.
    """

    outcome: Outcome
    judged: Judgement
    later: Record | None
    told: bool
    kinds: Sequence[EffectKind]
    seed: int

    def answer(self, certain: Certain, not_tested: tuple[NotTested, ...]) -> Diagnosis:
        """Write the answer; its provenance is left to who knows the records."""
        outcome = self.outcome
        compared, shrunk = self._compared()
        judged = held_to_account(self.judged, outcome, shrunk)
        bench = outcome.bench
        gains = Gains(bench)
        found = ()
        if judged.state != "unknown":
            found = named_causes(outcome, judged.departures, Worths(outcome, gains))
        causes = (*certain.causes, *found)
        sizes, untestable = detectable(outcome.rounds[0].bench, self.kinds)
        known = {one.effect for one in not_tested}
        sets = self._ambiguous()
        the_gap = self._gap(gains)
        loop = closed_loop(bench, self.later, self.seed, outcome.causes) if causes else None
        held = compared if shrunk is not None and shrunk.resolved else None
        whole = surplus(bench, best=judged.rest.white if judged.rest.resolved else None)
        return Diagnosis(
            state=judged.state,
            headline=headline(
                judged.state,
                gap=the_gap,
                causes=causes,
                shrink=shrunk,
                closed_loop=loop,
                ambiguous=sets,
                unknown=judged.unknown,
                effects=len(self.kinds),
            ),
            causes=causes,
            gap=the_gap,
            shrink=shrunk,
            experiment=self._experiment(),
            not_tested=(*not_tested, *(one for one in untestable if one.effect not in known)),
            detectable=sizes,
            ambiguous=sets,
            unknown=judged.unknown,
            k_steps=() if compared is None else k_steps(compared),
            closed_loop=loop,
            tournament=tournament_rows(outcome, judged.rest.nats),
            waterfall=waterfall(outcome, gains, the_gap.nats_per_tick, held) if found else (),
            audit=judged.audit,
            fingerprints=fingerprints(bench) if causes else (),
            score_map=score_map(outcome),
            lag_profile=lag_profile(bench, whole),
            maps=maps(bench, whole),
            identifiability=identifiability(outcome.rounds[0].bench, outcome.rounds[0].entries),
            geometry=geometry(bench.record.layout),
            provenance=Provenance(data_sha256="", seed=self.seed, versions={}),
        )

    def _gap(self, gains: Gains) -> Gap:
        stages: dict[str, float] = {}
        for entry in self.outcome.rounds[0].entries:
            stage = entry.kind.stage
            stages[stage] = max(stages.get(stage, 0.0), entry.candidate.gain)
        accepted = [one.accepted for one in self.outcome.winners if one.accepted is not None]
        rest = self.judged.rest
        return gap(
            self.outcome.bench,
            best=rest.white if rest.resolved else None,
            unseen=Unseen.of(self.outcome.bench, accepted),
            stage_gains=stages,
            seed=self.seed,
            gains=gains,
        )

    def _compared(self) -> tuple[Contrast | None, Shrink | None]:
        """Bring causes and competitors to the later record.

        That the causes leave a gap there speaks against them as far as healthy errors, of which the
        first record has not shown all, cannot have made it.
        """
        moving = [
            cause
            for cause in self.outcome.causes
            if not isinstance(cause.kind, NoiseKind | LatentKind)
        ]
        if self.later is None or not moving:
            return None, None
        bench, rivals = self.outcome.bench, self._rivals()
        net = fitted_net(bench, self.seed)
        where = "the later record" if self.told else "the end of the record"
        compared = contrast(bench, self.later, self.seed, rivals, net)
        shrunk = shrink(compared, where, net.note)
        if too_little(shrunk):
            rest = contrast(bench, self.later, self.seed, rivals, net, beyond_healthy=True)
            left = shrink(rest, f"{where}, beyond what healthy errors may do there", net.note)
            if (left.after_nats_per_tick or 0.0) * left.held_out_ticks < _HEALTHY:
                return rest, left
        return compared, shrunk

    def _rivals(self) -> tuple[Cause, ...]:
        """The best that were not accepted: a stand-in must not be judged by itself alone.

        One that is worth nothing would bring in what healthy errors do at its place.
        """
        named = {(cause.kind.id, cause.places) for cause in self.outcome.causes}
        found = [
            entry.cause
            for entry in self.outcome.rounds[0].entries
            if entry.fit is not None
            and entry.weight > 0.0
            and (entry.kind.id, entry.cause.places) not in named
        ]
        return tuple(found[:_RIVALS])

    def _ambiguous(self) -> tuple[AmbiguousSet, ...]:
        if self.judged.state != "ambiguous":
            return ()
        first = self.judged.groups[0]
        rivals = [entry.kind for entry in self.outcome.winners[0].rivals()]
        winner = self.outcome.winners[0].accepted
        ids = ([] if winner is None else [winner.kind.id]) + [kind.id for kind in rivals]
        every = dict.fromkeys((*ids, *first.kinds))
        splits = first.splits or next((kind.splits for kind in rivals if kind.splits), "")
        if self.outcome.sure:
            return (AmbiguousSet(effects=tuple(every), why=first.why, splits=splits),)
        why = "; ".join(filter(None, (_FAINT, first.why)))
        return (AmbiguousSet(effects=(*every, "no_gap"), why=why, splits=splits or _MORE),)

    def _experiment(self) -> Experiment | None:
        if self.judged.state != "ambiguous":
            return None
        one = self.outcome.winners[0]
        if one.accepted is None:
            return None
        rivals = [rival.cause for rival in one.rivals()[:_PLANNED]]
        found = plan(one.bench, one.accepted.cause, rivals, seed=self.seed + 1)
        return found.experiment
