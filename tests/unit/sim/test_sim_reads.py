"""Reads out of a stream of bytes, and the answers that caproto would give."""

import caproto as ca
import numpy as np

from orbitfb.sim.access.reads import READ, answers, leading_reads


def read(channel, request, count=1):
    return bytes(ca.ReadNotifyRequest(ca.ChannelType.DOUBLE, count, channel, request))


def test_a_run_of_reads_is_recognised_as_caproto_writes_it():
    run = leading_reads(b"x" * 3 + read(5, 70) + read(6, 71, count=0), 3)
    assert run["channel"].tolist() == [5, 6]
    assert run["request"].tolist() == [70, 71]


def test_a_run_ends_at_anything_else_and_at_half_a_message():
    time_double = bytes(ca.ReadNotifyRequest(ca.ChannelType.TIME_DOUBLE, 1, 5, 72))
    two = bytes(ca.ReadNotifyRequest(ca.ChannelType.DOUBLE, 2, 5, 72))
    for other in (time_double, two, read(5, 73)[:15], bytes(ca.EchoRequest())):
        assert len(leading_reads(read(5, 70) + other, 0)) == 1
        assert len(leading_reads(other, 0)) == 0


def test_answers_are_those_of_caproto():
    requests, values = [70, 71], [1.5, -2.25]
    expected = b"".join(
        bytes(ca.ReadNotifyResponse(data=[value], data_type=6, data_count=1, status=1, ioid=ioid))
        for ioid, value in zip(requests, values, strict=True)
    )
    assert answers(np.array(requests, dtype=np.uint32), np.array(values)) == expected


def test_a_read_is_a_bare_header():
    assert READ.itemsize == len(read(1, 2)) == 16
