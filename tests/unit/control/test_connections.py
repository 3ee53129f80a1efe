"""Who gives way when there are too many connections."""

from orbitfb.core.connections import Connections


def test_there_is_room_until_there_is_none():
    room: Connections[str] = Connections(2)
    assert room.add("a") is None and room.add("b") is None
    assert room.add("c") == "a"
    assert room.all() == ("b", "c") and len(room) == 2


def test_who_has_left_makes_room():
    room: Connections[str] = Connections(1)
    room.add("a")
    room.remove("a")
    room.remove("never came")
    assert room.add("b") is None


def test_the_busy_stay_and_the_new_one_has_to_go():
    room: Connections[str] = Connections(2)
    for each in "ab":
        room.add(each)
        room.keep(each)
    assert room.add("c") == "c"
    assert room.all() == ("a", "b") or set(room.all()) == {"a", "b"}


def test_who_had_to_go_cannot_stay_by_becoming_busy():
    room: Connections[str] = Connections(1)
    room.add("a")
    assert room.add("b") == "a"
    room.keep("a")
    assert room.all() == ("b",)


def test_whoever_opens_many_loses_their_own_first():
    room: Connections[str] = Connections(4)
    room.add("quiet", "10.0.0.1")
    flood = [f"flood {number}" for number in range(20)]
    left = [room.add(each, "10.0.0.66") for each in flood]
    assert "quiet" not in left and "quiet" in room.all()
    assert [its for its in left if its] == flood[:17]
