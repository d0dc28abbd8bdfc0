"""The card of a built object, row by row: what a person wants to know of it before using it."""

from __future__ import annotations

from collections import Counter

from objects.build import ObjectTables


def card_rows(built: ObjectTables) -> list[tuple[str, str]]:
    """Labels and texts; the name stands in the title of a card, scenes are not this room's."""
    row = built.objects[0]
    size = " x ".join(f"{row[f'size_{axis}_m'] * 1e3:.1f}" for axis in "xyz")
    com = ", ".join(f"{row[f'com_{axis}_m'] * 1e3:.1f}" for axis in "xyz")
    kinds = Counter(grasp["grasp_kind"] for grasp in built.grasp_pool)
    widths = [grasp["jaw_width_m"] * 1e3 for grasp in built.grasp_pool]
    rows = [
        ("size", f"{size} mm, {len(built.object_meshes[0]['faces']) // 3} faces"),
        *(("repaired", note) for note in built.notes),
        ("mass", f"{row['mass_kg'] * 1e3:.0f} g, centre of mass ({com}) mm, friction {row['friction']:.2f}"),
        ("symmetry", str(row["symmetry"])),
        ("parts", f"{len(built.object_parts)} convex, hull volume {row['hull_volume_ratio']:.3f} x mesh volume"),
        ("grasps", f"{len(built.grasp_pool)}: {kinds_text(kinds)}"),
        ("jaw widths", f"{min(widths):.1f} to {max(widths):.1f} mm"),
        ("source", str(row["source"])),
        ("hashes", f"mesh {row['mesh_sha256'][:12]}, parts {row['parts_sha256'][:12]}"),
    ]
    if row["cavity_fill"] is not None:
        rows.insert(4, ("fill", f"cavity {row['cavity_fill']:.1%}, handle hole {row['handle_hole_fill']:.1%}"))
    return rows


def kinds_text(kinds: Counter[str]) -> str:
    """Counts of grasp kinds by name."""
    return ", ".join(f"{kind} {kinds[kind]}" for kind in sorted(kinds)) or "none"
