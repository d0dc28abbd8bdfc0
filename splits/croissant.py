"""Croissant 1.1 metadata of a release with the RAI vocabulary: every file with its checksum, every column with meaning, unit and type.

Files are named by their paths in the release folder, so `mlcroissant.Dataset("croissant.json")` reads records without a network. The
standard is https://docs.mlcommons.org/croissant/docs/croissant-spec-1.1.html, the vocabulary .../croissant-rai-spec.html.
"""

from __future__ import annotations

import json
from typing import Any

import pyarrow as pa

from splits.citation import Citation
from splits.data_card import limits
from splits.hub_card import BENCHMARK_TAG, TAGS
from splits.manifest import BY_SPLIT, CARD, NAME, Manifest, files_of_table
from splits.own import LICENCE_OF_OWN, column_meaning, table_meaning
from splits.provenance import is_own
from splits.statements import (
    CLEANING,
    MAINTENANCE,
    MISSING,
    MISUSES,
    OWN_PURPOSE,
    PURPOSE,
    SENSITIVE,
    SOCIAL_IMPACT,
    USES,
    biases,
    label_checks,
    labelled_how,
    made_how,
)
from splits.summary import Summary
from tables.columns import Column, TableSchema
from tables.schemas import ALL_SCHEMAS, HEAVY_TABLES
from tables.vocabulary import Split

Json = dict[str, Any]

CONFORMS_TO = ("http://mlcommons.org/croissant/1.1", "http://mlcommons.org/croissant/RAI/1.0")
LICENCE_URL = "https://creativecommons.org/licenses/by/4.0/"
_PARQUET = "application/x-parquet"  # the name that readers of Croissant know

# The context of the standard, as its examples have it.
_OF_CROISSANT = (
    "arrayShape citeAs column containedIn equivalentProperty extract field fileProperty fileObject fileSet format includes isArray"
    " isLiveDataset jsonPath key md5 parentField path recordSet references regex repeated replace samplingRate separator source subField"
    " transform"
)
CONTEXT: Json = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "sc": "https://schema.org/",
    "cr": "http://mlcommons.org/croissant/",
    "rai": "http://mlcommons.org/croissant/RAI/",
    "dct": "http://purl.org/dc/terms/",
    "conformsTo": "dct:conformsTo",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "examples": {"@id": "cr:examples", "@type": "@json"},
    "name": {"@container": "@language"},
    "description": {"@container": "@language"},
    **{name: f"cr:{name}" for name in _OF_CROISSANT.split()},
}

_TYPES = {
    pa.string(): "sc:Text",
    pa.bool_(): "sc:Boolean",
    pa.int32(): "cr:Int32",
    pa.float32(): "cr:Float32",
    pa.float64(): "cr:Float64",
}
_ROLES = {Split.TRAIN: "cr:TrainingSplit", Split.VALIDATION: "cr:ValidationSplit", Split.TEST: "cr:TestSplit"}
_SPLIT_NAMES = "split_names"
_SPLIT_IN_PATH = "(?:.*split=)?([a-z]+)"  # of a name alone it gives the name: readers apply it once to join and once to read


def render_croissant(manifest: Manifest, summary: Summary, citation: Citation) -> str:
    """The content of `croissant.json`.

    Args:
        manifest: of the release; its entries of texts are not looked at.
        summary: counts in its tables.
        citation: how the data are cited; see `own.citation_of`.
    """
    tables = sorted(manifest.tables)
    content = {
        "@context": CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": list(CONFORMS_TO),
        "name": f"own-dataset-{manifest.tier}" if is_own(manifest.provenance) else f"{NAME}-{manifest.tier}",
        "description": f"{citation.abstract} {OWN_PURPOSE if is_own(manifest.provenance) else PURPOSE}",
        "version": manifest.version,
        "license": LICENCE_OF_OWN if is_own(manifest.provenance) else LICENCE_URL,
        "url": citation.url or CARD,
        "creator": [{"@type": "sc:Organization", "name": name} for name in citation.work.authors],
        "keywords": sorted({*TAGS, *citation.keywords} - ({BENCHMARK_TAG} if is_own(manifest.provenance) else set())),
        "inLanguage": "en",
        "citeAs": citation.bibtex(manifest.tier, manifest.version),
        **({"datePublished": date} if (date := citation.date_of(manifest.version)) else {}),
        **({"identifier": citation.url} if citation.url else {}),
        "isLiveDataset": False,
        **_responsible(manifest, summary),
        "distribution": [part for name in tables for part in _files(name, manifest)],
        "recordSet": [_split_names(), *(_record_set(ALL_SCHEMAS[name], manifest) for name in tables)],
    }
    return json.dumps(content, indent=1, ensure_ascii=False) + "\n"


def _responsible(manifest: Manifest, summary: Summary) -> Json:
    tools = [f"{name} {version}" for name, version in sorted(manifest.libraries.items())]
    return {
        "rai:dataCollection": made_how(summary),
        "rai:dataCollectionType": ["Software Collection", "Experiments"],
        "rai:dataCollectionMissingData": MISSING,
        "rai:dataCollectionRawData": "None: rows are computed from the catalogue, the recipe and the ids of scenes, and can be again.",
        "rai:dataImputationProtocol": "No value is imputed.",
        "rai:dataPreprocessingProtocol": [CLEANING],
        "rai:dataAnnotationProtocol": list(labelled_how()),
        "rai:dataAnnotationPlatform": [f"PlaceBench, commit {manifest.provenance['git_commit']}"],
        "rai:dataAnnotationAnalysis": [label_checks(summary)],
        "rai:annotationsPerItem": "One execution of the pipeline; repeats are in table attempts where the release holds it.",
        "rai:machineAnnotationTools": tools,
        "rai:dataBiases": list(biases(summary, manifest.provenance)),
        "rai:dataUseCases": [*USES, *(f"Not for: {misuse}" for misuse in MISUSES)],
        "rai:dataLimitations": limits(manifest.provenance),
        "rai:dataSocialImpact": SOCIAL_IMPACT,
        "rai:personalSensitiveInformation": [SENSITIVE],
        "rai:dataReleaseMaintenancePlan": MAINTENANCE,
    }


def _files(table: str, manifest: Manifest) -> list[Json]:
    """The files of a table; where they are several, also the set that its records are read from."""
    about = f"Table {table}: {table_meaning(ALL_SCHEMAS[table], manifest.provenance)}."
    if table in HEAVY_TABLES:
        again = HEAVY_TABLES[table]
        about += " Heavy: a light release leaves it out" + (f", `python -m splits.rebuild DIR {again}` makes it again." if again else ".")
    files: list[Json] = [
        {
            "@type": "cr:FileObject",
            "@id": file,
            "name": file,
            "description": about,
            "contentUrl": file,
            "contentSize": f"{manifest.files[file].bytes} B",
            "encodingFormat": _PARQUET,
            "sha256": manifest.files[file].sha256,
        }
        for file in files_of_table(table)
    ]
    if table in BY_SPLIT:
        name = _source_of(table)["fileSet"]["@id"]
        includes = f"{table}/split=*/*.parquet"
        files.append(
            {"@type": "cr:FileSet", "@id": name, "name": name, "description": about, "encodingFormat": _PARQUET, "includes": includes}
        )
    return files


def _source_of(table: str) -> Json:
    return {"fileSet": {"@id": f"{table}-files"}} if table in BY_SPLIT else {"fileObject": {"@id": files_of_table(table)[0]}}


def _split_names() -> Json:
    """The three splits and what each is for, as the standard names it."""
    fields = [("name", "sc:Text", "name of the split"), ("role", "sc:URL", "what it is for")]
    return {
        "@type": "cr:RecordSet",
        "@id": _SPLIT_NAMES,
        "name": _SPLIT_NAMES,
        "description": "The splits of scene groups, and what each is for.",
        "dataType": "cr:Split",
        "key": {"@id": f"{_SPLIT_NAMES}/name"},
        "field": [
            {
                "@type": "cr:Field",
                "@id": f"{_SPLIT_NAMES}/{name}",
                "name": f"{_SPLIT_NAMES}/{name}",
                "description": about,
                "dataType": dtype,
            }
            for name, dtype, about in fields
        ],
        "data": [{f"{_SPLIT_NAMES}/name": split.value, f"{_SPLIT_NAMES}/role": role} for split, role in _ROLES.items()],
    }


def _record_set(schema: TableSchema, manifest: Manifest) -> Json:
    fields = [_field(schema.name, column, column_meaning(column, manifest.provenance)) for column in schema.columns]
    if schema.name in BY_SPLIT:
        fields.append(_split_field(schema.name))
    return {
        "@type": "cr:RecordSet",
        "@id": schema.name,
        "name": schema.name,
        "description": f"{table_meaning(schema, manifest.provenance)}. {manifest.tables[schema.name].rows} rows.",
        "key": [{"@id": f"{schema.name}/{name}"} for name in schema.key],
        "field": fields,
    }


def _field(table: str, column: Column, meaning: str) -> Json:
    is_list = pa.types.is_list(column.dtype)
    of = column.dtype.value_type if is_list or pa.types.is_dictionary(column.dtype) else column.dtype
    about = [meaning + (f": {', '.join(column.values)}" if column.values else "")]
    about += [f"Unit: {column.unit}"] if column.unit else []
    about += ["May be null"] if column.nullable else []
    return {
        "@type": "cr:Field",
        "@id": f"{table}/{column.name}",
        "name": f"{table}/{column.name}",
        "description": ". ".join(about),
        "dataType": _TYPES[of],
        **({"unitText": column.unit} if column.unit else {}),
        **({"isArray": True, "arrayShape": "-1"} if is_list else {}),
        "source": {**_source_of(table), "extract": {"column": column.name}},
    }


def _split_field(table: str) -> Json:
    """The split of a row, which is in the path of its file."""
    return {
        "@type": "cr:Field",
        "@id": f"{table}/split",
        "name": f"{table}/split",
        "description": f"split of the scene, from the path of the file: {', '.join(split.value for split in Split)}",
        "dataType": "sc:Text",
        "source": {**_source_of(table), "extract": {"fileProperty": "fullpath"}, "transform": {"regex": _SPLIT_IN_PATH}},
        "references": {"field": {"@id": f"{_SPLIT_NAMES}/name"}},
    }
