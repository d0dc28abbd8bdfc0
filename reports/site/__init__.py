"""The results as static pages that open from a folder: what stands in them is content.py's, how they look is in the files beside it."""
