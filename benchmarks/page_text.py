"""What the performance page says beside its tables."""

HEAD = """# Performance

This page says how long a tick of the loop takes on Channel Access. The ring has 180 BPMs, 180
correctors and 180 readbacks, each a scalar PV. `make bench` measures and writes
`benchmarks/loop.json`. `.venv/bin/python -m benchmarks.page` writes this page from that file, and a
test compares the two.

"""

MISSED = """
The service does more in a tick than a plain loop, which reads, multiplies and writes. It screens
every reading, asks whether the ring answers, and hears who else puts a setpoint, which is one more
event per corrector. That is about half of its round trip, and why the plain loop takes less than 30
times as long. What the whole service missed at 100 Hz are orbits at which it wrote nothing, because
the readbacks did not show its last change yet. No orbit was lost, and the loop stayed CLOSED.

An IOC of caproto's documented calls alone needs about 0.1 s for the updates and puts of a tick,
whichever client asks for them.
"""

TAIL = """
## How it is measured

Every run is one server process and one client process on one computer, over loopback. Runs of
different kinds alternate within a repeat, so a noisy minute affects all of them. Their order
changes from repeat to repeat. A ratio divides the medians, over the repeats, of the p50 of each
run.

- **Servers.** There are three: our soft IOC; the same with `--plain`, which uses only caproto's
  documented calls; and an IOC of EPICS base. The last one writes and reads `ai` and `ao` records
  through ctypes, with addresses looked up beforehand and one time stamp by TSEL. All three step the
  same simulated ring and serve the same PVs.
- **Clients.** There are three: the loop alone (`EpicsMachine`, `Runner`, the SVD law); the whole
  service (history, archive, statistics, event log, learner, metrics); and the plain loop, as one
  would write it with pyepics. The plain loop has `PV(callback=…)` for every BPM, one matrix product
  after the last reading, and `PV.put` for every corrector. It reads no readbacks and checks
  nothing. pyepics monitors every PV by default. A second form of the plain loop does not monitor
  the correctors.
- **Stamps.** The server takes the stamp before it steps the ring. Clients and servers use the clock
  of the same computer.
- **Missed and torn.** One orbit is due in every period from the first orbit seen to the last. It is
  missed if no setpoints followed from it. The ring's random numbers come from its seed, so the
  orbit of every tick is known to the last digit. The run is replayed with the setpoints that were
  read back. An orbit is torn if it differs from the replay, or if its readbacks are of another
  tick. For the plain loop an orbit is torn if its stamps differ.
- **CPU.** The processes' own clocks, all threads.

A fixed rate is slower than lockstep, because the caches go cold between two ticks. No process has
real-time priority.

## What makes it fast

- The server writes all updates of a tick to a client in one go, from a prebuilt block of bytes, and
  picks puts and reads of setpoints out of the stream as arrays (`orbitfb.sim`).
- Nagle's delay is off, and a timerfd sets the rate.
- The server sends readbacks before BPMs. So the last BPM completes the tick, and the reader wakes
  once.
- The client subscribes directly through libca. A callback copies 24 bytes and counts them, and
  libca's thread keeps its Python state (`orbitfb.epics`).
- The client writes setpoints through libca with prepared arguments and flushes once.
- Before the setpoints are sent, the loop does only what it needs to decide. Subscribers run after
  that, and the archive and the learner have their own threads.
"""
