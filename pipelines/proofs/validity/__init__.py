"""Whether the held object's engine is valid: against theory, against itself, against the other engine. One module a test.

A test is a study (study.py): units of work, a function from a unit to a row, a summary of the rows. studies.py lists them all, and
running.py runs what is missing of one; criteria.py says what the numbers must be.
"""
