"""The shapes of --json that docs/reference/json.md documents, as JSON schemas."""

from __future__ import annotations

from typing import Any

import jsonschema

COUNT = {"type": "integer", "minimum": 0}
TEXT = {"type": "string", "minLength": 1}
PLACE = {
    "mesh": COUNT,
    "mesh_name": {"type": "string"},
    "primitive": COUNT,
    "attribute": TEXT,
}


def strict(properties: dict[str, Any], *, optional: dict[str, Any] | None = None) -> dict[str, Any]:
    """Return the schema of an object with these members and no others."""
    return {
        "type": "object",
        "properties": {**properties, **(optional or {})},
        "required": list(properties),
        "additionalProperties": False,
    }


WARNINGS = {
    "type": "array",
    "items": strict(
        {
            "code": {"type": "string", "pattern": "^[a-z]+(-[a-z]+)*$"},
            "message": TEXT,
            "count": {"type": "integer", "minimum": 1},
        },
        optional=PLACE,
    ),
}
ERROR = {
    "oneOf": [
        {"type": "null"},
        strict(
            {
                "kind": {"enum": ["InputError", "UnsupportedFeatureError", "OutputError"]},
                "message": TEXT,
            },
            optional=PLACE,
        ),
    ]
}
LIMITED = {
    "oneOf": [
        {"type": "null"},
        strict(
            {
                "influences": {"type": "integer", "multipleOf": 4, "minimum": 4},
                "vertices": COUNT,
                "left_out": {"type": "number", "minimum": 0, "maximum": 1},
            }
        ),
    ]
}
EXTENDED = {
    "oneOf": [
        {"type": "null"},
        strict({"influences": COUNT, "vertices": COUNT, "bytes": COUNT, "multiply_adds": COUNT}),
    ]
}
SHARE = {"type": "number", "minimum": 0, "maximum": 1}
BAKED = strict(
    {
        "mesh": COUNT,
        "primitive": COUNT,
        "vertices": COUNT,
        "triangles": COUNT,
        "degenerate_triangles": COUNT,
        "influences": {"type": "integer", "multipleOf": 4, "minimum": 4},
        "gradients": {"enum": ["surface", "fitted"]},
        "frame": {"enum": ["tangent", "normal"]},
        "generated_normals": {"type": "boolean"},
        "adopting_vertices": COUNT,
        "overflowing_vertices": COUNT,
        "lost_gradient": SHARE,
        "gradient": {"type": "number", "minimum": 0},
        "added_bytes": COUNT,
        "bytes_per_vertex": {"type": "integer", "minimum": 6},
        "limited": LIMITED,
        "extended": EXTENDED,
        "kept": {"oneOf": [{"type": "null"}, SHARE]},
    },
    optional={"mesh_name": {"type": "string"}},
)
ANGLE = {"type": "number", "minimum": 0, "maximum": 180}
ENCODING = {
    "oneOf": [
        {"type": "null"},
        strict(
            {
                "name": {"enum": ["float32", "snorm16", "packed8"]},
                "added_error": {"oneOf": [{"type": "null"}, strict({"mean": ANGLE, "p99": ANGLE})]},
            }
        ),
    ]
}
BY_TRUTH = strict({"triangles": ANGLE, "tangents": ANGLE})
NAMES = {"type": "array", "items": {"type": "string"}}
CORRECTIVES = strict(
    {
        "mesh": COUNT,
        "targets": {"type": "integer", "minimum": 1},
        "vertices": COUNT,
        "corrected": COUNT,
        "given_up": COUNT,
        "keys": COUNT,
        "clips": NAMES,
        "idle_clips": NAMES,
        "left": {"type": "number", "minimum": 0, "maximum": 1},
        "standard": BY_TRUTH,
        "remaining": BY_TRUTH,
        "added_bytes": COUNT,
    },
    optional={"mesh_name": {"type": "string"}},
)
MORPHS = strict(
    {
        "mesh": COUNT,
        "primitive": COUNT,
        "targets": {"type": "integer", "minimum": 1},
        "normals": COUNT,
        "frames": {"enum": [0, 4, 6]},
        "mean": ANGLE,
        "max": ANGLE,
        "added_bytes": COUNT,
    },
    optional={"mesh_name": {"type": "string"}},
)
MADE = strict(
    {
        "mesh": COUNT,
        "primitive": COUNT,
        "targets": COUNT,
        "normals": COUNT,
        "frames": {"enum": [0, 4, 6]},
        "changed": {"type": "boolean"},
    },
    optional={"mesh_name": {"type": "string"}},
)
SECONDS = {"type": "number", "minimum": 0}
TIMINGS = {"type": "object", "additionalProperties": SECONDS, "required": ["other"]}
PROCESS_TIMINGS = strict(
    {"start_up": {"type": ["number", "null"]}, "imports": SECONDS, "elapsed": SECONDS},
)
BAKE = strict(
    {
        "schema": {"const": "skinbake.bake/1"},
        "dry_run": {"type": "boolean"},
        "exit_code": {"enum": [0, 3, 4]},
        "files": {
            "type": "array",
            "minItems": 1,
            "items": strict(
                {
                    "input": TEXT,
                    "output": {"type": ["string", "null"]},
                    "status": {"enum": ["baked", "left", "unchanged", "up-to-date", "failed"]},
                    "left": {
                        "anyOf": [
                            {"type": "null"},
                            strict(
                                {
                                    "gain": {"type": ["number", "null"], "minimum": 0},
                                    "standard_error": {"type": ["number", "null"], "minimum": 0},
                                    "under": {"type": ["number", "null"], "minimum": 0},
                                    "reason": {"type": "string"},
                                }
                            ),
                        ]
                    },
                    "skipped": COUNT,
                    "primitives": {"type": "array", "items": BAKED},
                    "encoding": ENCODING,
                    "correctives": {"type": "array", "items": CORRECTIVES},
                    "morphs": {"type": "array", "items": MORPHS},
                    "warnings": WARNINGS,
                    "error": ERROR,
                },
                optional={"timings": TIMINGS},
            ),
        },
    },
    optional={"timings": PROCESS_TIMINGS},
)
SUMMARY = strict(
    {
        "mesh": COUNT,
        "primitive": COUNT,
        "vertices": COUNT,
        "triangles": COUNT,
        "joints": COUNT,
        "influence_sets": {"type": "integer", "minimum": 1},
        "influences": COUNT,
        "weight_sums": {"type": "array", "items": {"type": "number"}, "minItems": 2, "maxItems": 2},
        "defects": {"type": "object", "additionalProperties": COUNT},
        "frame": TEXT,
        "attributes": {
            "type": "object",
            "additionalProperties": strict({"format": TEXT, "bytes": {"type": "integer", "minimum": 1}}),
        },
        "compression": {"type": ["string", "null"]},
        "morph_targets": COUNT,
        "correctives": {
            "oneOf": [
                {"type": "null"},
                strict({"generator": TEXT, "targets": COUNT, "clips": NAMES, "changed": NAMES}),
            ]
        },
        "baked": {
            "oneOf": [
                {"type": "null"},
                strict(
                    {
                        "metadata": {"type": "object"},
                        "changed": {"type": "array", "items": TEXT},
                        "bytes": COUNT,
                    }
                ),
            ]
        },
    },
    optional={"mesh_name": {"type": "string"}},
)
INSPECT = strict(
    {
        "schema": {"const": "skinbake.inspect/1"},
        "input": TEXT,
        "bytes": COUNT,
        "meshes": COUNT,
        "skins": COUNT,
        "animations": COUNT,
        "left": {"type": "boolean"},
        "primitives": {"type": "array", "items": SUMMARY},
        "morphs": {"type": "array", "items": MADE},
        "warnings": WARNINGS,
    }
)
INSPECTED_FILES = strict(
    {
        "schema": {"const": "skinbake.inspect-files/1"},
        "exit_code": COUNT,
        "files": {
            "type": "array",
            "items": {
                "anyOf": [
                    strict(
                        {
                            **{key: of for key, of in INSPECT["properties"].items() if key != "schema"},
                            "error": {"type": "null"},
                        },
                        optional={"timings": TIMINGS},
                    ),
                    strict(
                        {"input": TEXT, "warnings": WARNINGS, "error": ERROR}, optional={"timings": TIMINGS}
                    ),
                ]
            },
        },
    },
    optional={"timings": PROCESS_TIMINGS},
)
STRIPPED_FILES = strict(
    {
        "schema": {"const": "skinbake.strip-files/1"},
        "exit_code": COUNT,
        "files": {
            "type": "array",
            "items": strict(
                {
                    "input": TEXT,
                    "output": TEXT,
                    "status": {"enum": ["stripped", "unchanged", "failed"]},
                    "primitives": COUNT,
                    "warnings": WARNINGS,
                    "error": ERROR,
                },
                optional={"timings": TIMINGS},
            ),
        },
    },
    optional={"timings": PROCESS_TIMINGS},
)
STRIP = strict(
    {
        "schema": {"const": "skinbake.strip/1"},
        "input": TEXT,
        "output": TEXT,
        "primitives": COUNT,
        "warnings": WARNINGS,
    }
)
WORST = strict(
    {
        "mesh": PLACE["mesh"],
        "primitive": PLACE["primitive"],
        "vertex": COUNT,
        "clip": {"type": "string"},
        "time": {"type": ["number", "null"]},
    },
    optional={"mesh_name": PLACE["mesh_name"]},
)
FIGURES = strict({"mean": ANGLE, "p95": ANGLE, "p99": ANGLE, "max": ANGLE, "worst": WORST})
GAIN = {"type": ["number", "null"], "minimum": 0}
NORMALS = strict(
    {},
    optional={
        "lbs": strict(
            {"standard": FIGURES, "direct": FIGURES, "accurate": FIGURES, "gain": GAIN},
            optional={"corrected": FIGURES},
        ),
        "dqs": strict({"standard": FIGURES, "accurate": FIGURES, "exact": FIGURES, "gain": GAIN}),
        "blend": strict({"standard": FIGURES, "accurate": FIGURES, "gain": GAIN}),
    },
)
NORMALS_BY_TANGENTS = strict(
    {},
    optional={
        "lbs": strict(
            {"standard": FIGURES, "accurate": FIGURES, "gain": GAIN}, optional={"corrected": FIGURES}
        ),
        "dqs": strict({"standard": FIGURES, "accurate": FIGURES, "exact": FIGURES, "gain": GAIN}),
        "blend": strict({"standard": FIGURES, "accurate": FIGURES, "gain": GAIN}),
    },
)
RELIEF_FIGURES = strict(
    {},
    optional={
        "lbs": strict({"standard": FIGURES, "engine_frame": FIGURES, "accurate": FIGURES, "gain": GAIN}),
        "dqs": strict(
            {
                "standard": FIGURES,
                "engine_frame": FIGURES,
                "accurate": FIGURES,
                "exact": FIGURES,
                "gain": GAIN,
            }
        ),
    },
)
RELIEFS = {
    "anyOf": [
        {"type": "null"},
        strict({"normals": RELIEF_FIGURES, "normals_by_area": RELIEF_FIGURES}),
    ]
}
CONCLUSIONS = ("nothing to correct", "little to win", "small gain", "clear gain")

VERIFY = strict(
    {
        "schema": {"const": "skinbake.verify/1"},
        "exit_code": {"enum": [0, 1, 3, 4]},
        "files": {
            "type": "array",
            "items": strict(
                {
                    "input": {"type": "string"},
                    "passed": {"type": "boolean"},
                    "up_to_date": {"type": "boolean"},
                    "checks": {
                        "type": "array",
                        "items": strict(
                            {
                                "name": {
                                    "enum": [
                                        "structure",
                                        "freshness",
                                        "identity",
                                        "lighting",
                                        "limits",
                                        "warnings",
                                        "sources",
                                    ]
                                },
                                "outcome": {"enum": ["passed", "failed", "skipped"]},
                                "remark": {"type": "string"},
                                "problems": WARNINGS,
                            }
                        ),
                    },
                    "left": {"type": "boolean"},
                    "conclusion": {"anyOf": [{"enum": [*CONCLUSIONS, None]}, {"pattern": "^better with "}]},
                    "others": {"type": "array", "items": strict({"options": TEXT, "error": ANGLE})},
                    "poses": {"type": ["string", "null"]},
                    "normals_by_triangles": {"anyOf": [{"type": "null"}, NORMALS]},
                    "normals_by_tangents": {"anyOf": [{"type": "null"}, NORMALS_BY_TANGENTS]},
                    "reliefs": RELIEFS,
                    "primitives": {
                        "type": "array",
                        "items": strict(
                            {
                                "mesh": PLACE["mesh"],
                                "primitive": PLACE["primitive"],
                                "normals_by_triangles": NORMALS,
                                "normals_by_tangents": NORMALS_BY_TANGENTS,
                                "reliefs": RELIEFS,
                            },
                            optional={"mesh_name": PLACE["mesh_name"]},
                        ),
                    },
                    "morphs": {"anyOf": [{"type": "null"}, strict({"targets": COUNT, "moving": COUNT})]},
                    "scaled_joints": {"type": "array", "items": {"type": "string"}},
                    "mixtures": {
                        "type": "array",
                        "items": strict({"name": TEXT, "standard": BY_TRUTH, "corrected": BY_TRUTH}),
                    },
                    "warnings": WARNINGS,
                    "error": {
                        "anyOf": [
                            {"type": "null"},
                            strict(
                                {"kind": {"type": "string"}, "message": {"type": "string"}}, optional=PLACE
                            ),
                        ]
                    },
                },
                optional={"timings": TIMINGS},
            ),
        },
    },
    optional={"timings": PROCESS_TIMINGS},
)


OPTION_VALUES = {
    "type": "object",
    "additionalProperties": strict(
        {
            "value": {},
            "origin": {"enum": ["default", "file", "override", "environment"]},
            "place": {"type": ["string", "null"]},
            "pattern": {"type": ["string", "null"]},
        }
    ),
}
OPTIONS_BY_COMMAND = {"type": "object", "additionalProperties": OPTION_VALUES}
CONFIG = strict(
    {
        "schema": {"const": "skinbake.config/1"},
        "file": {"type": ["string", "null"]},
        "commands": OPTIONS_BY_COMMAND,
        "files": {
            "type": "array",
            "items": strict({"input": TEXT, "commands": OPTIONS_BY_COMMAND}),
        },
    }
)


def checked(found: Any, schema: dict[str, Any]) -> Any:
    """Return the document, which must be of this schema."""
    jsonschema.Draft202012Validator.check_schema(schema)
    jsonschema.validate(found, schema, cls=jsonschema.Draft202012Validator)
    return found
