"""Light linking: what a light lights, and what casts its shadow."""

import bpy


def links_of(thing):
    """Names of the objects that a light lights, or that cast its shadow, where that is not all."""
    linking = getattr(thing, "light_linking", None)
    links = {}
    if linking and linking.receiver_collection:
        included, excluded = members(linking.receiver_collection)
        if included:
            links["only"] = included
        if excluded:
            links["except"] = excluded
    if linking and linking.blocker_collection:
        included, excluded = members(linking.blocker_collection)
        if included:
            excluded += [name for name in shown() if name not in included and name not in excluded]
        if excluded:
            links["no_shadow_from"] = excluded
    return links


def members(collection):
    """Names of a linking collection: included, excluded."""
    names = {"INCLUDE": [], "EXCLUDE": []}
    known = shown()
    for thing, state in zip(collection.objects, collection.collection_objects):
        names[state.light_linking.link_state] += [thing.name] * (thing.name in known)
    for child, state in zip(collection.children, collection.collection_children):
        names[state.light_linking.link_state] += [thing.name for thing in child.all_objects if thing.name in known]
    return names["INCLUDE"], names["EXCLUDE"]


def shown():
    """Names of the objects that relume has."""
    things = bpy.context.scene.objects
    return [thing.name for thing in things if thing.type not in {"LIGHT", "CAMERA", "EMPTY"} and not thing.hide_render]


def link(thing, entry):
    """Gives the light linking collections for the objects that relume names."""
    for attribute, suffix, included, excluded in (
        ("receiver_collection", "receivers", entry.get("only", []), entry.get("except", [])),
        ("blocker_collection", "blockers", [], entry.get("no_shadow_from", [])),
    ):
        states = {name: "INCLUDE" for name in included} | {name: "EXCLUDE" for name in excluded}
        found = {name: state for name, state in states.items() if name in bpy.data.objects}
        if not found:
            setattr(thing.light_linking, attribute, None)
            continue
        collection = bpy.data.collections.new(f"{thing.name} {suffix}")
        setattr(thing.light_linking, attribute, collection)
        for name, state in found.items():
            collection.objects.link(bpy.data.objects[name])
            collection.collection_objects[-1].light_linking.link_state = state
