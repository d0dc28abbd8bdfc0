"""Objects from the catalogue: watertight meshes, convex parts, stable poses, grasp pools.

See pipelines/running/object_tables.py for the work.
"""

from collections.abc import Iterator

from dagster import AssetCheckResult, AssetExecutionContext, AssetSpec, DataVersion, MaterializeResult, multi_asset

from assets_def.checks import schema_check, schema_check_spec
from assets_def.metadata import table_metadata
from assets_def.resources import Benchmark
from objects.provenance import OBJECT_CODE_VERSION
from pipelines.running.dataset_record import claim_dataset
from pipelines.running.object_tables import are_objects_current, make_object_tables
from tables.schemas import ALL_SCHEMAS, OBJECT_TABLES

# What `build_object` reads of the other tables' values on its way to each table.
_UPSTREAM = {
    "object_meshes": [],
    "object_parts": ["object_meshes"],
    "stable_poses": ["object_meshes"],
    "grasp_pool": ["object_meshes", "object_parts", "stable_poses"],
    "objects": ["object_meshes", "object_parts", "grasp_pool"],
}
_DESCRIPTIONS = {
    "object_meshes": "Builds one watertight triangle mesh for each catalogue object.",
    "object_parts": "Decomposes each mesh into convex parts with CoACD, the fewest that keep a mug's cavity and handle hole open.",
    "stable_poses": "Finds the poses in which each object rests on a table, merged by symmetry, with probabilities.",
    "grasp_pool": "Samples antipodal grasps on each mesh and keeps 64 diverse ones an object.",
    "objects": "Collects dimensions, mass properties, symmetry and the quality gates of each object.",
}


@multi_asset(
    name="make_objects",
    specs=[
        AssetSpec(
            name,
            deps=_UPSTREAM[name],
            description=f"{_DESCRIPTIONS[name]}\n\nRows: {ALL_SCHEMAS[name].meaning}.",
            group_name="objects",
            code_version=OBJECT_CODE_VERSION,
            kinds={"parquet"},
        )
        for name in OBJECT_TABLES
    ],
    check_specs=[schema_check_spec(ALL_SCHEMAS[name]) for name in OBJECT_TABLES],
)
def object_assets(context: AssetExecutionContext, benchmark: Benchmark) -> Iterator[MaterializeResult[None] | AssetCheckResult]:
    # Objects are shared by all families of scenes: the recipe refuses to have them differ, so that any family may be asked.
    claim_dataset(benchmark.root, benchmark.catalogue)
    sidecars = make_object_tables(benchmark.root, benchmark.recipe("full"), benchmark.catalogue, benchmark.n_workers, context.log.info)
    for name in ("object_meshes", "object_parts", "stable_poses", "grasp_pool", "objects"):
        path, schema = benchmark.root.object_table(name), ALL_SCHEMAS[name]
        metadata = table_metadata(schema, path, sidecars[name])
        yield MaterializeResult(name, metadata=metadata, data_version=DataVersion(sidecars[name].content_hash))
        yield schema_check(schema, path)


def are_objects_done(benchmark: Benchmark) -> bool:
    """Whether there is nothing to make, and every gate is open: a red one is never passed by because its table is up to date."""
    checks = (schema_check(ALL_SCHEMAS[name], benchmark.root.object_table(name)) for name in OBJECT_TABLES)
    is_current = are_objects_current(benchmark.root, benchmark.recipe("full"), benchmark.catalogue)
    return is_current and all(check.passed for check in checks)
