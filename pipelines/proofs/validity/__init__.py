"""Whether the held object's engine is valid: against theory, against itself, against the other engine. One module a test."""
