"""One client of the fast front: puts and reads from the byte stream, monitors from the feed."""

from contextlib import suppress
from typing import Any, Protocol

import caproto as ca
import numpy as np
from caproto.asyncio.server import VirtualCircuit
from numpy.typing import NDArray

from orbitfb.core.signals import Vector
from orbitfb.sim.access.arrays import BoardArray, BoardArraySetpoint
from orbitfb.sim.access.board import Board
from orbitfb.sim.access.channels import BoardChannel, BoardSetpoint
from orbitfb.sim.access.context import ClaimedContext
from orbitfb.sim.access.feed import Feed
from orbitfb.sim.access.frames import DOUBLE, LONGEST, TIME_DOUBLE, Monitor
from orbitfb.sim.access.listening import Sockets
from orbitfb.sim.access.puts import (
    PUT,
    PUT_COMMAND,
    WRITES,
    array_put,
    leading_puts,
    message_end,
)
from orbitfb.sim.access.queues import Commands, DroppingQueue
from orbitfb.sim.access.reads import READ, READ_COMMAND, answers, leading_reads
from orbitfb.sim.access.under_way import WritesUnderWay

_CHUNK = 65536
PROPERTY = int(ca.SubscriptionType.DBE_PROPERTY)
_VALUE_MASKS = ca.SubscriptionType.DBE_VALUE | ca.SubscriptionType.DBE_LOG


class BoardFront(Protocol):
    """What a client needs of the front that serves it; `FastFront` is one."""

    board: Board
    feeds: set[Feed]

    def take(self, which: NDArray[np.intp], values: Vector) -> None:
        """Put setpoints in force [A]: their places among the setpoints, their values."""
        ...

    def puts_taken(self) -> None:
        """Tell every client what was taken, once for all puts that came together."""
        ...


class FastCircuit(VirtualCircuit):
    """A client whose setpoint puts and monitors do not pass through caproto's objects."""

    def __init__(self, circuit: Any, client: Any, context: "FastContext") -> None:
        super().__init__(circuit, client, context)
        self.subscription_queue = DroppingQueue(ca.MAX_TOTAL_SUBSCRIPTION_BACKLOG)
        self.command_queue = Commands(self._keep, self._is_done)
        # It does what caproto calls of its own, and counts.
        # pyrefly: ignore[bad-override-mutable-attribute]
        self.write_event = self._writes = WritesUnderWay()
        self._front = context.front
        self._board = context.front.board
        self.feed = Feed(self._board, client.writer.transport, self.events_on.is_set)
        self._front.feeds.add(self.feed)
        self._rest = b""
        self._setpoint_of = np.full(1024, -1, dtype=np.intp)
        self._arrays: dict[int, NDArray[np.intp]] = {}
        self._queued: set[int] = set()

    async def recv(self) -> None:
        """Take what the client sent: setpoints at once, all else caproto's way."""
        data = await self.client.recv(_CHUNK)
        if not data:
            await super().recv()  # reads the end again, and acts on it
        data = self._rest + data
        start = slow_from = 0
        while (end := message_end(data, start)) is not None:
            if not self._behind and (
                fast := self._take_puts(data, start)
                or self._answer_reads(data, start)
                or self._take_array(data, start, end)
            ):
                await self._hand_over(data[slow_from:start])
                start = slow_from = start + fast
                continue
            if data[start + 1] in WRITES:  # what follows must not overtake this one
                await self._hand_over(data[slow_from:end])
                slow_from = end
            start = end
        await self._hand_over(data[slow_from:start])
        self._rest = data[start:]
        self._front.puts_taken()

    @property
    def _behind(self) -> bool:
        """Whether writes of this client are still under way in caproto."""
        return bool(self._queued) or self._writes.count > 0

    def _take_puts(self, data: bytes, start: int) -> int:
        """Apply the run of acceptable puts that begins at `start`; give its length in bytes."""
        if data[start + 1] != PUT_COMMAND:
            return 0
        run = leading_puts(data, start)
        which = self._setpoints_of(run)
        values = run["value"].astype(np.float64)
        refused = (which < 0) | ~self._board.allowed(which, values)
        count = int(refused.argmax()) if refused.any() else len(run)
        if count:
            self._front.take(which[:count], values[:count])
        return count * PUT.itemsize

    def _answer_reads(self, data: bytes, start: int) -> int:
        """Answer the run of reads of setpoints that begins at `start`; give its length in bytes."""
        transport = self.client.writer.transport
        if data[start + 1] != READ_COMMAND or transport.get_write_buffer_size():
            return 0  # who does not take his answers waits for them as caproto has it
        run = leading_reads(data, start)
        which = self._setpoints_of(run)
        unknown = which < 0
        count = int(unknown.argmax()) if unknown.any() else len(run)
        if count:
            values = self._board.setpoints[which[:count]]
            transport.write(answers(run["request"][:count], values))
        return count * READ.itemsize

    def _take_array(self, data: bytes, start: int, end: int) -> int:
        """Apply an acceptable put of a whole array; give its length in bytes."""
        if data[start + 1] != PUT_COMMAND:
            return 0
        put = array_put(data, start, end)
        which = None if put is None else self._arrays.get(put[0])
        if put is None or which is None:
            return 0
        values = put[1]
        if values.shape != which.shape or not self._board.allowed(which, values).all():
            return 0
        self._front.take(which, values)
        return end - start

    def _setpoints_of(self, run: NDArray[np.void]) -> NDArray[np.intp]:
        """Give the setpoint that each message is about; -1 where it is about something else."""
        channels = np.minimum(run["channel"].astype(np.intp), len(self._setpoint_of) - 1)
        return self._setpoint_of[channels]

    async def _hand_over(self, data: bytes) -> None:
        """Let caproto parse and process whole messages."""
        if not data:
            return
        commands, _ = self.circuit.recv(data)
        for command in commands:
            if isinstance(command, ca.WriteRequest | ca.WriteNotifyRequest):
                self._queued.add(id(command))
            await self.command_queue.put(command)

    def _is_done(self, command: Any) -> None:
        """Go on after a command that caproto has carried out."""
        self._queued.discard(id(command))
        if isinstance(command, ca.EventsOnRequest):
            self.feed.send_readings()
            self.feed.send_setpoints()

    async def _keep(self, command: Any) -> bool:
        """Carry out what is the feed's own; say whether caproto is not to see it."""
        if isinstance(command, ca.EventAddRequest):
            return await self._states(command) or self._monitors(command)
        if isinstance(command, ca.EventCancelRequest):
            self.feed.remove(command.subscriptionid)
        elif isinstance(command, ca.ClearChannelRequest):
            await self._clear(command.sid)
        return False

    def _monitors(self, command: Any) -> bool:
        """Add a subscription if the feed can serve it: whole values of the usual types."""
        channel = self.circuit.channels_sid.get(command.sid)
        entry = None if channel is None else self.context[channel.name]
        if (
            channel is None
            or not isinstance(entry, BoardChannel | BoardArray)
            or command.data_type not in (DOUBLE, TIME_DOUBLE)
            or command.data_count not in (0, len(entry.places))
            or len(entry.places) > LONGEST
            or not command.mask & _VALUE_MASKS
            or any(channel.channel_filter)
        ):
            return False
        try:
            self.circuit.process_command(command)
        except ca.CaprotoError:
            return False  # caproto answers what breaks the protocol
        what = (entry.places, command.subscriptionid, command.sid, int(command.data_type))
        self.feed.add(Monitor(*what))
        return True

    async def _states(self, command: Any) -> bool:
        """Answer a subscription to units and limits once: they never change."""
        channel = self.circuit.channels_sid.get(command.sid)
        entry = None if channel is None else self.context[channel.name]
        if (
            channel is None
            or not isinstance(entry, BoardChannel | BoardArray)
            or command.mask != PROPERTY
            or any(channel.channel_filter)
        ):
            return False
        try:
            self.circuit.process_command(command)
        except ca.CaprotoError:
            return False  # caproto answers what breaks the protocol
        metadata, values = await entry.read(command.data_type)
        count = command.data_count or len(values)
        await self.send(
            channel.subscribe(
                data=values[:count],
                metadata=metadata,
                data_type=command.data_type,
                data_count=count,
                subscriptionid=command.subscriptionid,
                status=1,
            )
        )
        return True

    async def send(self, *commands: Any) -> None:
        """Send; of a channel that comes into being, remember which setpoint it is."""
        for answer in commands:
            if isinstance(answer, ca.CreateChanResponse):
                name = self.circuit.channels[answer.cid].name
                entry = self.context[name]
                if name.removesuffix(".VAL") != getattr(entry, "pv", ""):
                    continue  # it was asked for with a filter, or is no value of the board
                if isinstance(entry, BoardSetpoint):
                    self._know(answer.sid, entry.index - self._board.readings)
                elif isinstance(entry, BoardArraySetpoint):
                    self._arrays[answer.sid] = entry.places - self._board.readings
        await super().send(*commands)

    def _know(self, channel: int, setpoint: int) -> None:
        """Remember which setpoint a channel is; the last place of the table stays unknown."""
        room = len(self._setpoint_of)
        if channel >= room - 1:
            more = np.full(max(channel + 2, 2 * room), -1, dtype=np.intp)
            more[:room] = self._setpoint_of
            self._setpoint_of = more
        self._setpoint_of[channel] = setpoint

    async def _clear(self, channel: int) -> None:
        """Drop what a channel had; caproto compares the wrong things and drops nothing."""
        self.feed.remove_channel(channel)
        self._know(channel, -1)
        self._arrays.pop(channel, None)
        everybody = self.context.subscriptions
        for spec, subscribed in self.subscriptions.items():
            gone = [one for one in subscribed if one.channel.sid == channel]
            for one in gone:
                subscribed.remove(one)
                everybody[spec].remove(one)
                with suppress(ValueError):
                    self.subscriptions_to_resend.get(spec, []).remove(one)
                self.context.last_dead_band.pop(one, None)
                self.context.last_sync_edge_update.pop(one, None)
            if gone and not everybody[spec]:
                await spec.db_entry.unsubscribe(self.context.subscription_queue, spec)


class FastContext(ClaimedContext):
    """A server whose clients are served by a fast front."""

    CircuitClass = FastCircuit

    def __init__(self, pvdb: dict[str, Any], sockets: Sockets, front: BoardFront) -> None:
        super().__init__(pvdb, sockets)
        self.front = front

    async def circuit_disconnected(self, circuit: Any) -> None:
        """Send nothing to a client that is gone."""
        self.front.feeds.discard(circuit.feed)
        await super().circuit_disconnected(circuit)
