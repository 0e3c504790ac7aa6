import numpy as np

from gpf.core.ply import write_ply


def test_the_bytes_of_points_and_of_a_mesh(tmp_path):
    points, colours = np.array([[1, 2, 3], [4, 5, 6.5]]), np.array([[7], [255]], np.uint8)
    columns = {"x y z": points, "red": colours}
    header = (
        b"ply\nformat binary_little_endian 1.0\nelement vertex 2\nproperty float x\n"
        b"property float y\nproperty float z\nproperty uchar red\n"
    )
    rows = b"".join(
        p.astype("<f4").tobytes() + bytes(c) for p, c in zip(points, colours, strict=True)
    )
    write_ply(tmp_path / "deep/points.ply", columns)
    assert (tmp_path / "deep/points.ply").read_bytes() == header + b"end_header\n" + rows
    write_ply(tmp_path / "mesh.ply", columns, np.array([[1, 0, 1]]))
    face = b"\x03" + np.array([1, 0, 1], "<i4").tobytes()
    header += b"element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    assert (tmp_path / "mesh.ply").read_bytes() == header + rows + face
