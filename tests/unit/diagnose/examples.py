"""Diagnoses made by hand: one with every block, others with what a state has."""

import numpy as np

from orbitfb.diagnose.result.blocks import (
    AmbiguousSet,
    Audit,
    ClosedLoop,
    Fingerprint,
    Geometry,
    GoodnessTest,
    HeatMap,
    Identifiability,
    KStep,
    LagProfile,
    ScoreMap,
    ScoreRow,
    Tournament,
    TournamentRow,
    Unknown,
    WaterfallStep,
)
from orbitfb.diagnose.result.diagnosis import Diagnosis
from orbitfb.diagnose.result.headline import headline
from orbitfb.diagnose.result.parts import (
    Binning,
    Cause,
    Detectable,
    Experiment,
    Finding,
    Gap,
    GapPiece,
    NotTested,
    ParameterValue,
    Provenance,
    Shrink,
)

BPMS, CORRECTORS, CELLS = 60, 60, 30
LENGTH = 792.0
EFFECTS = (
    "corrector-lag",
    "loop-delay",
    "corrector-slew",
    "bpm-lowpass",
    "corrector-gain",
    "quadrupole-gradient",
    "tune-shift",
    "bpm-gain",
    "corrector-hysteresis",
    "noise-level",
    "thermal-drift",
    "periodic-disturbance",
)


def provenance(**more):
    return Provenance(
        data_sha256="1f" * 32,
        seed=7,
        versions={"orbitfb": "0.1.0", "python": "3.11", "numpy": "2.3", "scipy": "1.16"},
        source="shift-2031-04-02.npz",
        ticks=3000,
        bpms=BPMS,
        correctors=CORRECTORS,
        planes="x",
        period_s=0.1,
        reading_noise_um=0.3,
        drift_um_per_tick=0.06,
        thresholds={"no_gap_nats": 6.0},
        **more,
    )


def lag_cause():
    return Cause(
        effect="corrector-lag",
        stage="actuator",
        places=tuple(f"COR{i:02d}" for i in range(6, 12)),
        parameters={
            "tau": ParameterValue(value=0.093, low=0.088, high=0.098, unit="s"),
        },
        probability=0.98,
        onset_s=112.4,
        title="lag of a corrector",
        sentence="The field follows the setpoint with a delay, as behind a thick chamber.",
        label="cells C04-C06",
        held_out_nats=412.0,
        drop_one_nats=398.0,
        shapley=0.93,
    )


def named(**changes):
    """A diagnosis with every block."""
    rng = np.random.default_rng(1)
    s = np.linspace(4.0, LENGTH - 4.0, BPMS)
    bpms = {f"BPM{i:02d}": float(s[i]) for i in range(BPMS)}
    correctors = {f"COR{i:02d}": float(s[i] + 2) for i in range(CORRECTORS)}
    peak = np.exp(-0.5 * ((np.arange(CORRECTORS) - 8.5) / 2) ** 2)
    gap = Gap(
        nats_per_tick=0.42,
        low=0.39,
        high=0.45,
        um=0.11,
        um_low=0.1,
        um_high=0.12,
        floor_um=0.31,
        by_stage={"actuator": 0.38, "optics": 0.02, "sensor": 0.01, "noise": 0.01, "timing": 0.0},
        by_bpm=dict(zip(bpms, 0.42 * rng.dirichlet(np.full(BPMS, 0.7)) - 0.001, strict=True)),
        by_corrector=dict(zip(correctors, 0.2 * peak + 0.002, strict=True)),
        um_by_bpm=dict(zip(bpms, rng.uniform(0.02, 0.2, BPMS), strict=True)),
        by_mode=np.geomspace(0.08, 0.0002, BPMS),
        by_band=tuple(
            GapPiece(
                label=f"{low:g}-{2 * low:g} Hz",
                start=low,
                stop=2 * low,
                nats_per_tick=value,
                low=value - 0.02,
                high=value + 0.02,
                resolved=value > 0.02,
            )
            for low, value in ((0.1, 0.01), (0.2, 0.03), (0.4, 0.08), (0.8, 0.14), (1.6, 0.16))
        ),
        by_window=tuple(
            GapPiece(
                label=str(i),
                start=30.0 * i,
                stop=30.0 * (i + 1),
                nats_per_tick=0.66 if i > 3 else 0.005,
                low=0.55 if i > 3 else -0.02,
                high=0.75 if i > 3 else 0.03,
                resolved=i > 3,
            )
            for i in range(10)
        ),
        by_bin=(
            Binning(
                title="size of the change of the setpoints",
                unit="mA",
                pieces=tuple(
                    GapPiece(
                        label=f"{i}-{i + 1}",
                        nats_per_tick=0.03 * i,
                        low=0.03 * i - 0.02,
                        high=0.03 * i + 0.02,
                        resolved=i > 0,
                    )
                    for i in range(5)
                ),
            ),
            Binning(
                title="reversal of the direction",
                pieces=(
                    GapPiece(label="goes on", nats_per_tick=0.2, low=0.17, high=0.24),
                    GapPiece(label="reverses", nats_per_tick=0.22, low=0.19, high=0.26),
                ),
            ),
        ),
        floor_from="estimated with the record",
    )
    shrink = Shrink(
        nats=0.96,
        low=0.94,
        high=0.98,
        um=0.94,
        um_low=0.91,
        um_high=0.97,
        held_out_ticks=1500,
        competitor_um=0.41,
        competitor_nats=-0.3,
        on="the later record",
        before_nats_per_tick=0.41,
        after_nats_per_tick=0.016,
        before_um=0.11,
        after_um=0.007,
    )
    loop = ClosedLoop(
        without_um=0.336,
        with_um=0.352,
        with_low=0.348,
        with_high=0.356,
        measured_um=0.349,
        measured_low=0.344,
        measured_high=0.354,
        radius_without=0.82,
        radius_with=0.91,
        frequency_hz=np.linspace(0.05, 5, 100),
        psd_measured=0.02 / (0.2 + np.linspace(0.05, 5, 100)) * rng.uniform(0.8, 1.2, 100),
        psd_without=0.018 / (0.25 + np.linspace(0.05, 5, 100)),
        psd_with=0.02 / (0.2 + np.linspace(0.05, 5, 100)),
    )
    heights = [412, 180, 170, 60, 44, 20, 9, 4, 3, 1.2, -0.5, -4]
    classes = {"corrector-slew": ("corrector-slew", "bpm-lowpass")}
    classes["bpm-lowpass"] = classes["corrector-slew"]
    content = {
        "state": "named",
        "causes": (lag_cause(),),
        "gap": gap,
        "shrink": shrink,
        "experiment": Experiment(
            kind="amplitude-ladder",
            text="Step three correctors in both directions at three amplitudes.",
            splits=("corrector-lag", "corrector-slew"),
            devices=("COR08", "COR09"),
            amplitude=0.02,
            orbit_cost_um=1.8,
            minutes=3.5,
            separation_nats=42.0,
            limits="10 % of the beam size, 1 A per tick",
            file="experiment.toml",
        ),
        "not_tested": (
            NotTested(effect="bpm-roll", reason="needs both planes"),
            NotTested(effect="bpm-current", reason="no current was recorded"),
        ),
        "detectable": (
            Detectable(effect="corrector-gain", parameter="gain", size=0.08, unit="1", best=0.02),
            Detectable(effect="bpm-gain", parameter="gain", size=0.03, unit="1"),
            Detectable(effect="sextupole", parameter="scale", size=float("nan"), unit="1"),
        ),
        "findings": (
            Finding(
                check="repeated-samples",
                severity="warning",
                text="BPM17 told the same reading 12 times in a row",
                devices=("BPM17",),
                rows=(411, 412),
            ),
        ),
        "provenance": provenance(holdout_source="shift-2031-04-03.npz", holdout_sha256="2e" * 32),
        "ambiguous": (
            AmbiguousSet(
                effects=("corrector-slew", "bpm-lowpass"),
                why="one amplitude only",
                splits="three amplitudes",
            ),
        ),
        "k_steps": tuple(
            KStep(
                k=k,
                nominal_um=0.11 * k**0.4,
                nominal_low=0.1 * k**0.4,
                nominal_high=0.12 * k**0.4,
                effect_um=0.007,
                effect_low=0.0,
                effect_high=0.012,
                competitor_um=0.065 * k**0.7,
                floor_um=0.31 * k**0.1,
                resolved=k < 50,
            )
            for k in (1, 2, 5, 10, 50)
        ),
        "closed_loop": loop,
        "tournament": Tournament(
            rows=tuple(
                TournamentRow(
                    effect=effect,
                    places="cells C04-C06" if i == 0 else "COR08",
                    nats=nats,
                    low=nats - 4 - 0.1 * abs(nats),
                    high=nats + 4 + 0.1 * abs(nats),
                    probability=0.98 if i == 0 else 0.01 if i < 3 else 0.0,
                    members=classes.get(effect, (effect,)),
                    accepted=i == 0,
                )
                for i, (effect, nats) in enumerate(zip(EFFECTS, heights, strict=True))
            ),
            ceiling_nats=430.0,
        ),
        "waterfall": (
            WaterfallStep(label="nominal", fit=0.42, held_out=0.41),
            WaterfallStep(label="+ corrector-lag", fit=0.01, held_out=0.016),
        ),
        "audit": Audit(
            tests=(
                GoodnessTest(name="overall chi²", value=1.2, limit=3.0, flagged=False),
                GoodnessTest(name="kurtosis", value=4.1, limit=3.5, flagged=True, note="BPM17"),
            ),
            quantiles=np.sort(rng.standard_normal(300)),
            autocorrelation=rng.normal(0, 0.004, 10),
            autocorrelation_limit=0.01,
            worst_channels={"BPM17": 1.31, "BPM02": 1.08},
            worst_ticks={"412": 2.2},
            sensitivity=("With half the prior width tau moves by 1 %.",),
        ),
        "fingerprints": (
            Fingerprint(
                title="Slope of the answer to a change, by its age",
                x_label="ticks after the change",
                y_label="share of the change [1]",
                x=np.arange(6.0),
                measured=[0.0, 0.68, 0.22, 0.07, 0.02, 0.01],
                nominal=[0, 1, 0, 0, 0, 0],
                refit=[0.0, 0.67, 0.22, 0.075, 0.025, 0.008],
                error=np.full(6, 0.02),
            ),
        ),
        "score_map": ScoreMap(
            rows=(
                ScoreRow(
                    stage="actuator",
                    effect="corrector-lag",
                    gain=400 * peak,
                    s_m=np.array(list(correctors.values())),
                    names=tuple(correctors),
                    fitted=tuple(range(6, 12)),
                    within=(5, 12),
                ),
                ScoreRow(
                    stage="sensor",
                    effect="bpm-gain",
                    gain=rng.exponential(2, BPMS),
                    s_m=s,
                    names=tuple(bpms),
                ),
                ScoreRow(
                    stage="optics",
                    effect="quadrupole-gradient",
                    gain=rng.exponential(3, 120),
                    s_m=np.linspace(1, LENGTH - 1, 120),
                ),
            ),
            threshold_nats=11.0,
        ),
        "lag_profile": LagProfile(
            lags=(0, 1, 2, 3, 4, 5),
            slope=[0.0, -0.32, 0.22, 0.07, 0.02, 0.0],
            low=[-0.03, -0.35, 0.19, 0.04, -0.01, -0.03],
            high=[0.03, -0.29, 0.25, 0.1, 0.05, 0.03],
            refit=[0.0, -0.01, 0.01, 0.0, 0.0, 0.0],
        ),
        "maps": (
            HeatMap(
                title="Gap by BPM and frequency",
                row_label="BPM",
                column_label="frequency [Hz]",
                values=rng.exponential(0.01, (BPMS, 20)),
                columns=np.linspace(0.1, 5, 20),
                row_names=tuple(bpms),
                unit="nats/tick",
            ),
        ),
        "identifiability": Identifiability(
            effects=("corrector-lag", "corrector-slew", "bpm-lowpass"),
            cosine=[[1.0, 0.8, 0.3], [0.8, 1.0, None], [0.3, None, 1.0]],
            degenerate=("All BPM gains and all corrector gains are one degree of freedom.",),
        ),
        "geometry": Geometry(
            bpms=bpms,
            correctors=correctors,
            sectors_m=np.arange(CELLS) * LENGTH / CELLS,
            sector_names=tuple(f"C{i + 1:02d}" for i in range(CELLS)),
            circumference_m=LENGTH,
        ),
    }
    content["headline"] = headline(
        "named", gap=gap, causes=content["causes"], shrink=shrink, closed_loop=loop
    )
    return Diagnosis(**{**content, **changes})


def bare(state="no_gap", **more):
    """A diagnosis that has nothing but what it must have."""
    content = {"state": state, "headline": "No gap is resolved.", "provenance": provenance()}
    return Diagnosis(**{**content, **more})


def unknown():
    """A diagnosis of a gap that no effect explains."""
    its = Unknown(
        stages={"sensor": 0.7, "actuator": 0.2, "optics": 0.1},
        places=("BPM03",),
        text="One BPM, only while the current is topped up.",
        nearest="bpm-current",
        nearest_nats=4.0,
        explained=0.11,
    )
    gap = Gap(nats_per_tick=0.1, low=0.08, high=0.12, um=0.05, floor_um=0.3)
    said = headline("unknown", gap=gap, unknown=its, effects=43)
    return bare("unknown", headline=said, gap=gap, unknown=its)


def broken():
    """A diagnosis of a record that is not intact."""
    finding = Finding(
        check="readback-differs",
        severity="failure",
        text="the readback of <b>COR04</b> stays while its setpoint moves",
        devices=("<b>COR04</b>",),
        rows=(3, 9),
    )
    return bare(None, headline=headline(None, findings=(finding,)), findings=(finding,))
