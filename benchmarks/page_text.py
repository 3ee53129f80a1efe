"""What the performance page says beside its tables."""

HEAD = """# Performance

What the loop costs on Channel Access: 180 BPMs and 180 correctors, each a scalar PV of its own,
and 180 readbacks. `make bench` measures it and writes `benchmarks/loop.json`; this page is written
from that file by `.venv/bin/python -m benchmarks.page`, and a test compares the two.

"""

TAIL = """
## How it is measured

Every run is one server process and one client process on one computer, over loopback. Runs of
different kinds alternate within a repeat, so that a noisy minute hits all of them, and the order
turns from repeat to repeat. Ratios are of medians over the repeats of the p50 of each run.

- **Servers.** Our soft IOC; the same with `--plain`, which uses only caproto's documented calls; an
  IOC of EPICS base: `ai` and `ao` records put and got through ctypes with addresses looked up
  beforehand, one time stamp by TSEL. All three step the same simulated ring and serve the same PVs.
- **Clients.** The loop alone (`EpicsMachine`, `Runner`, the SVD law); the whole service (history,
  archive, statistics, event log, learner, metrics); and the loop as one would write it with
  pyepics: `PV(callback=…)` for every BPM, one matrix product when the last one has come, `PV.put`
  for every corrector. pyepics monitors every PV unless told not to; a second form of the plain loop
  tells it so for the correctors. The plain loop reads no readbacks and checks nothing.
- **Stamps.** The server takes the stamp before it steps the ring; both clients and all servers use
  the clock of one computer.
- **Missed and torn.** An orbit is due at every period between the first and the last one that were
  seen; it is missed unless setpoints followed from it. The ring's random numbers come from its
  seed, so the orbit of every tick is known to the last digit: the run is replayed under the
  setpoints that were read back, and an orbit that differs, or one whose readbacks are of another
  tick, counts as torn. For the plain loop it is one whose stamps differ.
- **CPU.** From the processes' own clocks, all threads.

A fixed rate is slower than lockstep: between two ticks the caches go cold. No process has real-time
priority. In the runs at 100 Hz that missed orbits, server or client stood still for about 40 ms
(see the longest round trip); the loop then holds, and closes again after three good orbits, which
are counted as missed too. The cause was not found: the collector pauses for at most 16 ms, and
after a client that was stopped on purpose the stream goes on at once. A virtual machine whose
processor is shared, as here, is the likeliest.

## What makes it fast

- The server writes all updates of a tick to a client in one go, from a prebuilt block of bytes, and
  picks puts and reads of setpoints out of the stream as arrays (`orbitfb.sim`).
- Nagle's delay is off, and a timerfd gives the beat.
- Readbacks are sent before the BPMs: the last BPM completes the tick, and the reader is woken once.
- The client subscribes through libca itself; a callback copies 24 bytes and counts, and libca's
  thread keeps its Python state (`orbitfb.epics`).
- Setpoints are put through libca with prepared arguments and flushed once.
- Nothing that the loop does not need to decide happens before the setpoints have left: subscribers
  come after, the archive and the learner have threads of their own.
"""
