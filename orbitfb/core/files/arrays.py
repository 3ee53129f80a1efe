"""What numpy says of a file of arrays that it cannot read."""


def first_line(error: BaseException) -> str:
    """Give what is wrong, without numpy's advice to trust the file and run what is in it.

    Args:
        error: Raised by numpy, or by what unpacks the file.
    """
    first = str(error).partition("\n")[0]
    return first.partition(" If you trust the file")[0].rstrip(".")
