#!/usr/bin/env python3
"""One step of the dense bundle adjustment in NumPy, on the inputs of `worker/vision/benches/bundle.rs`.

    bundle_twin.py time [--repeat N]   prints frames,edges,columns,rows,best,median,norm of the pose step
    bundle_twin.py versions

Edge by edge over whole grids, float64; one matrix product per source frame for the Schur complement;
LAPACK for the poses. Set OPENBLAS_NUM_THREADS=1 to compare single threads.
"""

import argparse
import platform
import time

import numpy as np

GRIDS = [(32, 32), (64, 48)]
SIZES = [(8, 30), (30, 30), (30, 300), (100, 30), (100, 300), (100, 2000)]
LM, EP, SCALE, MIN_DEPTH = float(np.float32(1e-5)), float(np.float32(1e-2)), 0.001, 0.25


def rotation(q):
    x, y, z, w = q
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ])


def ends(frames, count):
    pairs = [p for span in range(1, frames) for i in range(frames - span) for p in ((i, i + span), (i + span, i))]
    return pairs[:count]


def inputs(frames, count, columns, rows):
    k = np.arange(columns * rows)
    poses = []
    for i in range(frames):
        q = np.array([0.005 * np.sin(2 * i), 0.005 * np.cos(3 * i), 0.002 * np.sin(i), 1.0])
        poses.append((rotation(q / np.linalg.norm(q)), np.array([0.05 * i, 0.02 * np.sin(i), 0.03 * np.cos(i)])))
    depths = np.array([0.8 + 0.3 * np.sin(0.1 * k + i) for i in range(frames)])
    pairs = ends(frames, count)
    fields = []
    for i, j in pairs:
        u = (k % columns + 1.5 * np.sin(0.05 * k + i - j)).astype(np.float32)
        v = (k // columns + np.cos(0.04 * k + i + j)).astype(np.float32)
        w = (0.5 + 0.4 * np.sin(0.3 * k + i - j)).astype(np.float32)
        fields.append((np.stack([u, v]), w))
    focal, centre = float(columns), (0.5 * columns, 0.5 * rows)
    rays = np.stack([(k % columns - centre[0]) / focal, (k // columns - centre[1]) / focal, np.ones(k.size)])
    by_source = {}
    for e, (i, _) in enumerate(pairs):
        by_source.setdefault(i, []).append(e)
    return poses, depths, pairs, fields, focal, centre, rays, by_source


def step(data):
    poses, depths, pairs, fields, focal, centre, rays, by_source = data
    frames, cells = depths.shape
    size = 6 * frames
    S, g = np.zeros((size, size)), np.zeros(size)
    kept = []
    for i, edges in sorted(by_source.items()):
        C, rhs = np.full(cells, 1e-3), np.zeros(cells)
        E = np.zeros((len(edges) + 1, 6, cells))
        slots = [i] + [pairs[e][1] for e in edges]
        d = depths[i]
        for n, e in enumerate(edges):
            j = pairs[e][1]
            R = poses[j][0] @ poses[i][0].T
            t = poses[j][1] - R @ poses[i][1]
            X = R @ rays + t[:, None] * d
            valid = X[2] >= MIN_DEPTH
            D = np.where(valid, 1 / np.where(valid, X[2], 1), 0)
            a, b, h = X[0] * D, X[1] * D, d * D
            zero = np.zeros(cells)
            J = focal * np.stack([
                np.stack([h, zero, -a * h, -a * b, 1 + a * a, -b]),
                np.stack([zero, h, -b * h, -1 - b * b, a * b, a]),
            ])
            Jz = focal * np.stack([(t[0] - a * t[2]) * D, (t[1] - b * t[2]) * D])
            target, weight = fields[e]
            w = SCALE * weight.astype(np.float64) * valid
            r = target - np.stack([focal * a + centre[0], focal * b + centre[1]])
            Jw = J * w
            H = Jw[0] @ J[0].T + Jw[1] @ J[1].T
            b_ = Jw[0] @ r[0] + Jw[1] @ r[1]
            Ej = Jw[0] * Jz[0] + Jw[1] * Jz[1]
            tx = np.array([[0, -t[2], t[1]], [t[2], 0, -t[0]], [-t[1], t[0], 0]])
            Ad = np.zeros((6, 6))
            Ad[:3, :3] = Ad[3:, 3:] = R
            Ad[:3, 3:] = tx @ R
            si, sj = slice(6 * i, 6 * i + 6), slice(6 * j, 6 * j + 6)
            S[sj, sj] += H
            S[sj, si] -= H @ Ad
            S[si, sj] -= Ad.T @ H
            S[si, si] += Ad.T @ H @ Ad
            g[sj] += b_
            g[si] -= Ad.T @ b_
            E[n + 1] = Ej
            E[0] -= Ad.T @ Ej
            C += w * (Jz[0] ** 2 + Jz[1] ** 2)
            rhs += w * (r[0] * Jz[0] + r[1] * Jz[1])
        E = E.reshape(-1, cells)
        Q = 1 / C
        EQ = E * Q
        index = np.concatenate([np.arange(6 * s, 6 * s + 6) for s in slots])
        S[np.ix_(index, index)] -= EQ @ E.T
        g[index] -= EQ @ rhs
        kept.append((i, index, E, Q, rhs))
    S, g = S[6:, 6:], g[6:]
    S[np.diag_indices_from(S)] += EP + LM * np.diag(S)
    L = np.linalg.cholesky(S)
    dx = np.concatenate([np.zeros(6), np.linalg.solve(L.T, np.linalg.solve(L, g))])
    new = depths.copy()
    for i, index, E, Q, rhs in kept:
        new[i] += Q * (rhs - dx[index] @ E)
    return dx, new


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("command", choices=["time", "versions"])
    parser.add_argument("--repeat", type=int, default=5)
    arguments = parser.parse_args()
    if arguments.command == "versions":
        print(f"NumPy {np.__version__}, Python {platform.python_version()}")
        return
    for columns, rows in GRIDS:
        for frames, edges in SIZES:
            data = inputs(frames, edges, columns, rows)
            times = []
            for _ in range(arguments.repeat):
                started = time.perf_counter()
                dx, _ = step(data)
                times.append(1e3 * (time.perf_counter() - started))
            best, median = min(times), sorted(times)[len(times) // 2]
            print(f"{frames},{edges},{columns},{rows},{best:.4f},{median:.4f},{np.linalg.norm(dx):.9e}", flush=True)


main()
