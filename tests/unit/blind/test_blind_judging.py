"""The scorer of the blind check, on answers made by hand."""

import pytest

from benchmarks.blind.figures import figures
from benchmarks.blind.judging import Judged, Order, judge
from benchmarks.blind.truth import TrueEffect, Truth
from orbitfb.physics.places import Ring


@pytest.fixture(scope="module")
def order() -> Order:
    return Order(Ring.load())


def truth(*effects: str, known: bool = True, places: tuple[str, ...] = (), **more) -> Truth:
    its = tuple(
        TrueEffect(
            effect,
            frozenset({effect} if known else more.pop("kin", ())),
            known,
            more.get("stage", "sensor"),
            frozenset(places),
            {"gain": 0.05},
        )
        for effect in effects
    )
    return Truth(its, "easy" if its else "none", shrink=more.get("shrink"), oracle_nats=400.0)


def cause(effect: str, probability: float = 0.97, **more):
    return {"effect": effect, "probability": probability, **more}


def said(state: str, *causes, **more):
    return {"state": state, "causes": list(causes), **more}


def value(name: str, *cases: Judged) -> float:
    return next(one.value for one in figures(cases) if one.name == name)


def test_a_right_answer() -> None:
    interval = {"gain": {"value": 0.049, "low": 0.04, "high": 0.06, "unit": "1"}}
    told = cause("bpm-gain", places=["A", "B"], parameters=interval)
    shrink = {"um": 0.95, "on": "the later record", "held_out_ticks": 1000}
    shrink |= {"before_nats_per_tick": 0.45, "after_nats_per_tick": 0.05}
    asked = truth("bpm-gain", places=("A", "B"), shrink=1.0)
    found = judge(asked, said("named", told, shrink=shrink))
    assert (found.right, found.exact, found.misnamed) == (True, True, False)
    assert (found.devices, found.covered, found.on_right) == (1.0, True, 0.97)
    assert (found.recovered, found.shrink) == (pytest.approx(1.0), 0.95)
    assert value("right first or in class, easy and medium", found) == 1.0
    assert value("shrink over what knowing the effect removes (µm)", found) == 0.95
    outside = {"gain": {"low": 0.06, "high": 0.07}}
    found = judge(asked, said("named", cause("bpm-gain", parameters=outside)))
    assert found.covered is False


def test_the_declared_class_counts_up_to_three_members() -> None:
    for count, right in ((1, True), (2, True), (3, False)):
        others = [f"other-{number}" for number in range(count - 1)]
        told = cause("bpm-offset", alternatives=[*others, "bpm-gain"])
        found = judge(truth("bpm-gain"), said("ambiguous", told))
        assert (found.right, found.exact) == (right, False)


def test_devices_are_intersection_over_union() -> None:
    asked = truth("bpm-gain", places=("A", "B", "C"))
    found = judge(asked, said("named", cause("bpm-gain", places=["A", "B", "D"])))
    assert found.devices == pytest.approx(2 / 4)
    found = judge(asked, said("named", cause("bpm-gain", places=[])))
    assert found.devices == 0.0


PVS_OF_CH1A = (
    "SR:C30-MG{PS:CH1A}I:Sp1-SP",
    "SR:C30-MG{PS:CH1A}I:Sp2-SP",
    "SR:C30-MG{PS:CH1A}I:Ps1DCCT1-I",
    "SR:C30-MG{PS:CH1A}I:Ps2DCCT1-I",
)


@pytest.mark.parametrize("true", [*PVS_OF_CH1A, "CH1A_C30", "CH1A_C30 (y)"])
@pytest.mark.parametrize("named", [*PVS_OF_CH1A[:2], "CH1A_C30", "CH1A_C30 (x)", "CH1A_C30 (y)"])
def test_a_device_is_the_same_under_each_of_its_names(true: str, named: str, order: Order) -> None:
    asked = truth("corrector-gain", places=(true,))
    for others, good in (([], 1.0), (["CH2A_C30"], 1 / 2)):
        answer = said("named", cause("corrector-gain", places=[named, *others]))
        assert judge(asked, answer, order=order).devices == good


def test_a_device_with_both_its_planes_counts_once(order: Order) -> None:
    pvs = [f"SR:C30-BI{{BPM:{bpm}}}Pos:{plane}-I" for bpm in (1, 2) for plane in "XY"]
    asked = truth("bpm-gain", places=tuple(pvs))
    for named in (["PH1A_C30"], ["PH1A_C30 (x)", "PH1A_C30 (y)"]):
        answer = said("named", cause("bpm-gain", places=named))
        assert judge(asked, answer, order=order).devices == 1 / 2


def test_planes_are_told_apart_from_names_without_a_ring_too() -> None:
    asked = truth("bpm-gain", places=("M1", "M2"))
    answer = said("named", cause("bpm-gain", places=["M1 (x)", "M2 (x)"]))
    assert judge(asked, answer).devices == 1.0


@pytest.mark.parametrize(
    ("named", "good"), [("QH2A_C30", 1.0), ("QH3A_C30", 0.0), ("CH1A_C30", 1.0)]
)
def test_a_neighbour_is_good_for_a_quadrupole(named: str, good: float, order: Order) -> None:
    asked = truth("quadrupole-gradient", places=("QH1A_C30",), stage="optics")
    answer = said("named", cause("quadrupole-gradient", places=[named]))
    assert judge(asked, answer, order=order).devices == good


def test_a_neighbour_is_no_good_for_a_bpm(order: Order) -> None:
    asked = truth("bpm-gain", places=("PH1A_C30",))
    answer = said("named", cause("bpm-gain", places=["PH2A_C30"]))
    assert judge(asked, answer, order=order).devices == 0.0


def test_misnamed_is_sure_without_reserve_and_wrong() -> None:
    asked = truth("bpm-gain")
    for state, chance, wrong in (
        ("named", 0.95, True),
        ("named", 0.6, False),
        ("named_plus_remainder", 0.95, False),
        ("ambiguous", 0.95, False),
    ):
        assert judge(asked, said(state, cause("bpm-roll", chance))).misnamed is wrong
    assert not judge(asked, said("named", cause("bpm-gain", 0.95))).misnamed


def test_nothing_is_right_only_if_it_is_said() -> None:
    assert judge(truth(), said("no_gap")).right
    assert not judge(truth(), said("unknown")).right
    named = judge(truth(), said("named", cause("bpm-gain")))
    assert (named.right, named.misnamed) == (False, True)
    assert value("no gap: a name given", named, judge(truth(), said("no_gap"))) == 0.5


def test_an_effect_of_no_library_is_to_be_recognised_or_its_kin_named() -> None:
    asked = truth("x-new", known=False, kin={"bpm-gain"})
    assert judge(asked, said("unknown")).right
    assert judge(asked, said("named_plus_remainder", cause("bpm-roll"))).right
    assert judge(asked, said("named", cause("bpm-gain"))).right
    sure = judge(asked, said("named", cause("bpm-roll")))
    assert (sure.right, sure.misnamed) == (False, True)


def test_a_pair_wants_both() -> None:
    asked = truth("bpm-gain", "corrector-lag")
    both = judge(asked, said("named", cause("corrector-lag"), cause("bpm-gain")))
    one = judge(asked, said("named", cause("bpm-gain")))
    none = judge(asked, said("unknown"))
    assert [(j.right, j.one) for j in (both, one, none)] == [
        (True, True),
        (False, True),
        (False, False),
    ]


def test_no_answer_is_wrong() -> None:
    found = judge(truth("bpm-gain"), None, problem="died")
    assert (found.state, found.right, found.on_right) == ("crash", False, 0.0)
    assert judge(truth("bpm-gain"), {"state": None}).state == "not intact"


def test_the_tournament_tells_what_is_on_the_right_effect() -> None:
    rows = [
        {"effect": "bpm-roll", "nats": 9.0, "probability": 0.7, "members": ["bpm-roll"]},
        {"effect": "bpm-offset", "nats": 7.0, "probability": 0.2, "members": ["bpm-gain"]},
    ]
    answer = said("ambiguous", cause("bpm-roll", 0.7), tournament={"rows": rows})
    found = judge(truth("bpm-gain"), answer)
    assert (found.on_right, found.right, found.top3) == (0.2, False, False)


def test_a_shrink_is_told_too_large_by_a_wrong_name_or_where_less_was_there() -> None:
    name = "shrink ≥ 0.9 told and wrong"
    shrunk = {"um": 0.95}
    wrong = judge(truth("bpm-gain"), said("named", cause("bpm-roll"), shrink=shrunk))
    less = judge(truth("bpm-gain", shrink=0.5), said("named", cause("bpm-gain"), shrink=shrunk))
    right = judge(truth("bpm-gain", shrink=0.9), said("named", cause("bpm-gain"), shrink=shrunk))
    assert [value(name, one) for one in (wrong, less, right)] == [1.0, 1.0, 0.0]
