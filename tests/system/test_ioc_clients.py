"""The soft IOC under the clients that people use: caproto, pyepics, aioca."""

import pytest
from ioc_clients import CHANNELS, CURRENT, KICK, RF, TICK, run_client, serving
from service_process import START

pytestmark = pytest.mark.system

BPM, SETPOINT, READBACK = (
    CHANNELS.orbit_pvs[0],
    CHANNELS.setpoint_pvs[0],
    CHANNELS.readback_pvs[0],
)


@pytest.fixture(scope="module", params=["fast", pytest.param("plain", marks=pytest.mark.nightly)])
def port(request):
    with serving(rate_hz=10, plain=request.param == "plain") as child:
        yield child.port


def test_caproto_client(port):
    seen = run_client(
        port,
        f"""
        import json, time
        from caproto.threading.client import Context
        context = Context()
        names = {[BPM, SETPOINT, READBACK, TICK]!r}
        bpm, setpoint, readback, tick = context.get_pvs(*names)
        got = []
        def keep(sub, response): got.append(response.data[0])
        subscription = tick.subscribe(data_type="time")
        subscription.add_callback(keep)
        native = []
        def keep_native(sub, response): native.append(response.data[0])
        for kind in ("control", "native"):
            other = tick.subscribe(data_type=kind)
            other.add_callback(keep_native)
        setpoint.write([1.5], wait=True)
        refused = []
        for pv, value in ((setpoint, 19.0), (setpoint, float("nan")), (bpm, 1.0)):
            try:
                pv.write([value], wait=True, timeout=0.5)
            except Exception as error:
                refused.append(type(error).__name__)
        time.sleep(1.0)
        passed = max(got) - min(got) + 1
        control = bpm.read(data_type="control").metadata
        drive = setpoint.read(data_type="control").metadata
        back = readback.read().data[0]
        value = setpoint.read().data[0]
        context.disconnect()
        print(json.dumps([refused, passed, len(got), len(native), control.units.decode(),
            control.precision, control.upper_alarm_limit, drive.units.decode(),
            drive.lower_ctrl_limit, drive.upper_ctrl_limit, back, value]))
        """,
    )
    refused, passed, timed, native, units, precision, alarm, *drive, back, value = seen
    assert len(refused) == 3
    assert passed >= 10 and timed >= 0.9 * passed
    assert native >= 2 * 0.8 * passed
    assert (units, precision, alarm) == ("mm", 5, 3.0)
    assert drive == ["A", -18.0, 18.0]
    assert (back, value) == (1.5, 1.5)


def test_pyepics(port):
    seen = run_client(
        port,
        f"""
        import json, os, time
        import epics
        pvs = [epics.PV(name, auto_monitor=True) for name in
               {[BPM, SETPOINT, READBACK, TICK, CURRENT, RF, SETPOINT + ".VAL"]!r}]
        for pv in pvs: assert pv.wait_for_connection(10), pv.pvname
        bpm, setpoint, readback, tick, current, rf, val = pvs
        stamps = []
        tick.add_callback(lambda **kw: stamps.append((kw["posixseconds"], kw["nanoseconds"])))
        setpoint.put(2.5, wait=True)
        try:
            bpm.put(1.0); refused = False
        except Exception: refused = True
        before = tick.get()
        time.sleep(1.0)
        setpoint.put(25.0, wait=True)
        time.sleep(0.3)
        setpoint.get_ctrlvars()
        print(json.dumps([refused, tick.get() - before, len(set(stamps)),
            setpoint.get(), setpoint.severity, readback.get(), current.get(), rf.get(),
            setpoint.units, setpoint.precision, setpoint.upper_ctrl_limit,
            setpoint.upper_alarm_limit, setpoint.upper_warning_limit, val.get()]), flush=True)
        os._exit(0)
        """,
    )
    assert seen[0]
    assert 8 <= seen[1] <= 16 and seen[2] >= 8
    assert seen[3:6] == [2.5, 2, 2.5]
    assert seen[6:8] == [400.0, pytest.approx(499.68e6, rel=1e-5)]
    assert seen[8:12] == ["A", 5, 18.0, 18.0] and seen[12] == pytest.approx(16.2)
    assert seen[13] == 2.5


def test_aioca(port):
    """Ten whole orbits in a row; on a busy computer the first ones may come in pieces."""
    seen = run_client(
        port,
        f"""
        import asyncio, json
        from aioca import caget, caput, camonitor, FORMAT_TIME, FORMAT_CTRL
        async def main():
            names = {[*list(CHANNELS.orbit_pvs), TICK]!r}
            vectors = {{}}
            def keep(value, row):
                vectors.setdefault(value.raw_stamp, set()).add(row)
            def longest():
                run = most = 0
                for _, rows in sorted(vectors.items()):
                    run = run + 1 if len(rows) == len(names) else 0
                    most = max(most, run)
                return most
            monitors = camonitor(names, keep, format=FORMAT_TIME, all_updates=True)
            for _ in range(300):
                await asyncio.sleep(0.1)
                if longest() >= 10: break
            for monitor in monitors: monitor.close()
            await caput({SETPOINT!r}, 3.5, wait=True, timeout={START})
            refused = []
            for name, value in (({SETPOINT!r}, -18.5), ({BPM!r}, 0.0)):
                try:
                    await caput(name, value, wait=True, timeout={START})
                except Exception as error:
                    refused.append(type(error).__name__)
            await caput({KICK!r}, 0.5, wait=True, timeout={START})
            control = await caget({BPM!r}, format=FORMAT_CTRL, timeout={START})
            value = await caget({SETPOINT!r}, timeout={START})
            return [longest(), refused, control.units, control.precision, float(value)]
        print(json.dumps(asyncio.run(main())))
        """,
    )
    whole, refused, *rest = seen
    assert whole >= 10
    assert len(refused) == 2
    assert rest == ["mm", 5, 3.5]
