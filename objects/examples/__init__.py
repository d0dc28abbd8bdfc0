"""A catalogue of three meshes that are not the benchmark's: what the README builds as a dataset of one's own."""
