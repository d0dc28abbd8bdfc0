import tables  # noqa: F401 - before numpy, see there
