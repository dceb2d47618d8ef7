"""Light linking: what a light lights, and what casts its shadow."""

import bpy

from . import rendered


def links_of(thing, scene):
    """Names of the objects that a light lights, or that cast its shadow, where that is not all."""
    known = shown(scene)
    linking = getattr(thing, "light_linking", None)
    links = {}
    if linking and linking.receiver_collection:
        included, excluded = members(linking.receiver_collection, known)
        if included:
            links["only"] = included
        if excluded:
            links["except"] = excluded
    if linking and linking.blocker_collection:
        included, excluded = members(linking.blocker_collection, known)
        if included:
            excluded += [name for name in known if name not in included and name not in excluded]
        if excluded:
            links["no_shadow_from"] = excluded
    return links


def members(collection, known):
    """Names of a linking collection that are `known`: included, excluded."""
    names = {"INCLUDE": [], "EXCLUDE": []}
    for thing, state in zip(collection.objects, collection.collection_objects):
        names[state.light_linking.link_state] += [thing.name] * (thing.name in known)
    for child, state in zip(collection.children, collection.collection_children):
        names[state.light_linking.link_state] += [thing.name for thing in child.all_objects if thing.name in known]
    return names["INCLUDE"], names["EXCLUDE"]


def shown(scene):
    """Names of the objects that relume has."""
    kinds = {"LIGHT", "CAMERA", "EMPTY"}
    return [thing.name for thing in rendered.objects(scene) if thing.type not in kinds and not thing.hide_render]


def has_others(names):
    """Whether relume names what is no object of Blender's, as sets and materials."""
    return any(name not in bpy.data.objects for name in names)


def link(thing, entry):
    """Gives the light linking collections for the objects that relume names."""
    for attribute, suffix, included, excluded in (
        ("receiver_collection", "receivers", entry.get("only", []), entry.get("except", [])),
        ("blocker_collection", "blockers", [], entry.get("no_shadow_from", [])),
    ):
        states = {name: "INCLUDE" for name in included} | {name: "EXCLUDE" for name in excluded}
        found = {name: state for name, state in states.items() if name in bpy.data.objects}
        if not found or has_others(states):
            setattr(thing.light_linking, attribute, None)
            continue
        collection = bpy.data.collections.new(f"{thing.name} {suffix}")
        setattr(thing.light_linking, attribute, collection)
        for name, state in found.items():
            collection.objects.link(bpy.data.objects[name])
            collection.collection_objects[-1].light_linking.link_state = state
