"""A meshcat window without a server: it keeps the scene and turns it into one HTML page.

meshcat's own window starts a server in another process, whose web port listens on all addresses. This one opens no
socket: it stores the same commands in meshcat's own tree, and the page carries meshcat's viewer and the commands.
"""

from __future__ import annotations

import base64
import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import meshcat
import numpy as np
import umsgpack
from meshcat.geometry import Geometry, Material
from meshcat.servers.tree import SceneTree, find_node, walk
from numpy.typing import NDArray

from calib.show.shapes import Triangles

#: How msgpack-lite, meshcat's decoder in the browser, names typed arrays.
_ARRAYS = {
    np.dtype(np.int8): ("Int8Array", 0x11),
    np.dtype(np.uint16): ("Uint16Array", 0x14),
    np.dtype(np.uint32): ("Uint32Array", 0x16),
    np.dtype(np.float32): ("Float32Array", 0x17),
}


class SceneWindow:
    """The scene tree, for ``meshcat.Visualizer(window=...)``.

    meshcat's identifiers hold the time and this computer's network address; here they follow from the content, so
    that the same scene is the same bytes and a mesh that is drawn four times is stored once.
    """

    def __init__(self) -> None:
        self._tree = SceneTree()
        self._geometries: dict[str, dict[str, Any]] = {}

    def send(self, command: Any) -> None:  # noqa: ANN401  a command of meshcat
        """Take a command, as meshcat's server does."""
        message = command.lower()
        path = [part for part in message["path"].split("/") if part]
        node = find_node(self._tree, path)
        if message["type"] == "set_object":
            self._share(message["object"], message["path"])
            node.object, node.properties = message, []
        elif message["type"] == "set_transform":
            node.transform = message
        else:
            node.properties.append(message)

    def scene(self) -> bytes:
        """The whole scene as one message: the geometries by name, and the commands in order."""
        commands = []
        for node in walk(self._tree):
            commands += [node.object] if node.object else []
            commands += node.properties
            commands += [node.transform] if node.transform else []
        packed: bytes = umsgpack.packb({"geometries": self._geometries, "commands": commands})
        return packed

    def _share(self, lowered: dict[str, Any], path: str) -> None:
        """Name everything by its content or path, and keep the geometries apart."""
        names = []
        for geometry in lowered.get("geometries", []):
            del geometry["uuid"]
            name = hashlib.sha256(umsgpack.packb(geometry)).hexdigest()[:32]
            self._geometries.setdefault(name, {"uuid": name, **geometry})
            names.append(name)
        for material in lowered.get("materials", []):
            material["uuid"] = f"material of {path}"
        lowered["object"]["uuid"] = f"object of {path}"
        if names:
            lowered["geometries"] = names
            lowered["object"]["geometry"] = names[0]
            lowered["object"]["material"] = lowered["materials"][0]["uuid"]


class PackedGeometry(Geometry):  # type: ignore[misc]
    """Triangles with their normals, in meshcat's form."""

    def __init__(self, triangles: Triangles) -> None:
        super().__init__()
        self.triangles = triangles

    def lower(self, _object_data: dict[str, Any]) -> dict[str, Any]:
        """The geometry as three.js reads it."""
        mesh = self.triangles
        return {
            "uuid": self.uuid,
            "type": "BufferGeometry",
            "data": {
                "attributes": {
                    "position": _packed(mesh.vertices, 3),
                    "normal": {**_packed(mesh.normals, 3), "normalized": True},
                },
                "index": _packed(mesh.faces, 1),
            },
        }


class ShadowMaterial(Material):  # type: ignore[misc]
    """A surface that shows the shadows on it and nothing else."""

    def __init__(self, opacity: float) -> None:
        super().__init__()
        self.opacity = opacity

    def lower(self, _object_data: dict[str, Any]) -> dict[str, Any]:
        """The material as three.js reads it."""
        return {
            "uuid": self.uuid,
            "type": "ShadowMaterial",
            "color": 0x1B2733,
            "transparent": True,
            "opacity": self.opacity,
            "depthWrite": False,
        }


class KeyLight(meshcat.geometry.Object):  # type: ignore[misc]
    """A light from far away that casts shadows within a sphere about the scene's origin.

    Args:
        direction: shape (3,), towards the light.
        radius: Of the sphere, [m].
        intensity: 1 lights a surface that faces it in its full colour.
    """

    def __init__(self, direction: NDArray[np.float64], radius: float, intensity: float) -> None:
        self.uuid = ""
        self.position = 3.0 * radius * direction / np.linalg.norm(direction)
        self.radius = radius
        self.intensity = intensity

    def lower(self) -> dict[str, Any]:
        """The light as three.js reads it."""
        r = self.radius
        T = np.eye(4)
        T[:3, 3] = self.position
        return {
            "metadata": {"version": 4.5, "type": "Object"},
            "object": {
                "uuid": self.uuid,
                "type": "DirectionalLight",
                "color": 0xFFFFFF,
                "intensity": self.intensity,
                "matrix": T.T.ravel().tolist(),
                "shadow": {
                    "bias": -0.0003,
                    "normalBias": 0.002 * r,
                    "mapSize": [4096, 4096],
                    "camera": {
                        "uuid": "shadow camera",
                        "type": "OrthographicCamera",
                        "left": -r,
                        "right": r,
                        "top": r,
                        "bottom": -r,
                        "near": 1.5 * r,
                        "far": 4.5 * r,
                        "zoom": 1.0,
                    },
                },
            },
        }


@dataclass(frozen=True, slots=True)
class _NoShadow:
    """A property of an object; meshcat's own command would write its name in small letters."""

    path: str

    def lower(self) -> dict[str, Any]:
        """The command as a message."""
        return {
            "type": "set_property",
            "path": f"{self.path}/<object>",
            "property": "castShadow",
            "value": False,
        }


def without_shadow(node: meshcat.Visualizer) -> None:
    """Let an object of the scene cast no shadow."""
    node.window.send(_NoShadow(node.path.lower()))


def viewer_script() -> str:
    """The viewer of meshcat, three.js included, as the text of a script."""
    return (_viewer_folder() / "dist" / "main.min.js").read_text(encoding="utf-8")


def viewer_licences() -> str:
    """The notices that must go with a copy of the viewer: meshcat's own and those of what it contains."""
    folder = _viewer_folder()
    names = (
        "LICENSE",
        "dist/main.min.js.LICENSE.txt",
        "dist/main.min.js.THIRD_PARTY_LICENSES.json",
    )
    files = [folder / name for name in names]
    return "\n\n".join(file.read_text(encoding="utf-8") for file in files if file.is_file())


def as_base64(data: bytes) -> str:
    """Bytes as text that needs no escaping."""
    return base64.b64encode(data).decode("ascii")


def _viewer_folder() -> Path:
    """Where meshcat keeps its viewer."""
    return Path(meshcat.viewer_assets_path())


def _packed(array: NDArray[Any], item_size: int) -> dict[str, Any]:
    """An array in little-endian bytes with its type."""
    name, code = _ARRAYS[array.dtype]
    data = np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("<")).tobytes()
    return {
        "itemSize": item_size,
        "type": name,
        "array": umsgpack.Ext(code, data),
        "normalized": False,
    }
