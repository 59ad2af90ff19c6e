"use strict";
// What came with the page, as a graphics card takes it: three corners of each triangle.
const porousBody = async (data, half) => {
  const AXES = [0, 1, 2];
  const PHASES = ["solid", "pore"];
  const CREASE = Math.cos((40 * Math.PI) / 180);
  const STEPS = 65535;

  const bytes = async (text) => {
    const packed = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
    return new Uint8Array(await new Response(stream).arrayBuffer());
  };

  // Numbers of ``size`` bytes, low bytes of all first.
  const numbers = (from, start, count, size) => {
    const result = new Uint32Array(count);
    for (let plane = 0; plane < size; plane++)
      for (let i = 0, at = start + plane * count; i < count; i++) result[i] |= from[at + i] << (8 * plane);
    return result;
  };

  const cornersOf = (from, count) => {
    const places = new Uint16Array(3 * count);
    for (let axis = 0; axis < 3; axis++) {
      const steps = numbers(from, 2 * axis * count, count, 2);
      for (let i = 0, place = 0; i < count; i++) places[3 * i + axis] = place = (place + steps[i]) & STEPS;
    }
    return places;
  };

  const trianglesOf = (from, count) => {
    const [first, second, third] = [0, 1, 2].map((k) => numbers(from, 4 * k * count, count, 4));
    const result = new Uint32Array(3 * count);
    for (let i = 0, corner = 0; i < count; i++) {
      corner = (corner + first[i]) >>> 0;
      result.set([corner, corner + second[i], corner + third[i]], 3 * i);
    }
    return result;
  };

  // Area vectors of triangles, and of each corner the mean of those about it, up to creases.
  const normalsOf = (places, triangles, size) => {
    const count = triangles.length / 3;
    const normals = new Float32Array(3 * count);
    const lengths = new Float32Array(count);
    const starts = new Uint32Array(places.length / 3 + 1);
    for (let t = 0; t < count; t++) {
      const [a, b, c] = [0, 1, 2].map((k) => 3 * triangles[3 * t + k]);
      const u = size.map((s, k) => s * (places[b + k] - places[a + k]));
      const v = size.map((s, k) => s * (places[c + k] - places[a + k]));
      const n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
      normals.set(n, 3 * t);
      lengths[t] = Math.hypot(...n);
      for (let k = 0; k < 3; k++) starts[triangles[3 * t + k] + 1]++;
    }
    for (let i = 1; i < starts.length; i++) starts[i] += starts[i - 1];
    const about = new Uint32Array(3 * count);
    const filled = starts.slice();
    for (let i = 0; i < 3 * count; i++) about[filled[triangles[i]]++] = (i / 3) | 0;
    const result = new Int8Array(4 * 3 * count);
    for (let i = 0; i < 3 * count; i++) {
      const own = 3 * ((i / 3) | 0);
      let [x, y, z] = [0, 0, 0];
      for (let k = starts[triangles[i]]; k < starts[triangles[i] + 1]; k++) {
        const n = 3 * about[k];
        const cosine = normals[own] * normals[n] + normals[own + 1] * normals[n + 1] + normals[own + 2] * normals[n + 2];
        if (n !== own && cosine < CREASE * lengths[own / 3] * lengths[n / 3]) continue;
        x += normals[n];
        y += normals[n + 1];
        z += normals[n + 2];
      }
      const length = Math.hypot(x, y, z) || 1;
      result.set([(127 * x) / length, (127 * y) / length, (127 * z) / length], 4 * i);
    }
    return result;
  };

  // Of each corner of each triangle: place, normal, values; a value that is not known is another's.
  const unfolded = (places, triangles, values) => {
    const size = AXES.map((a) => (data.corners.box[1][a] - data.corners.box[0][a]) / half / STEPS);
    const place = new Uint16Array(4 * triangles.length);
    const value = new Uint16Array(2 * triangles.length);
    triangles.forEach((corner, i) => {
      const first = i - (i % 3);
      for (let axis = 0; axis < 3; axis++) place[4 * i + axis] = places[3 * corner + axis];
      values.forEach((of, phase) => {
        if (of) value[2 * i + phase] = of[corner] || Math.max(...[0, 1, 2].map((k) => of[triangles[first + k]]));
      });
    });
    return { place, normal: normalsOf(places, triangles, size), value };
  };

  const [corners, triangles, greys, ...values] = await Promise.all([
    bytes(data.corners.bytes),
    bytes(data.triangles.bytes),
    data.greys && bytes(data.greys.bytes),
    ...PHASES.map((phase) => data.values[phase] && bytes(data.values[phase].bytes)),
  ]);
  const count = data.corners.count;
  const known = values.map((of) => of && numbers(of, 0, count, 2));
  const folded = [cornersOf(corners, count), trianglesOf(triangles, data.triangles.count)];
  return { greys, ...unfolded(...folded, known) };
};
