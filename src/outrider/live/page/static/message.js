// One picture: a size, a head in JSON, columns of float32 (message.py says what they are).

export function unpack(buffer, columns) {
  const size = new DataView(buffer).getUint32(0, true);
  const picture = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, size)));
  let offset = 4 + size;
  for (const [name, ...shape] of picture.arrays) {
    const length = shape.reduce((a, b) => a * b, 1);
    picture[name] = new Float32Array(buffer, offset, length);
    offset += 4 * length;
  }
  picture.steps = picture.arrays[2][2]; // poses of an arc
  picture.rows = picture.id.map((id, i) => row(picture, i, columns));
  return picture;
}

function row(picture, i, columns) {
  const track = { id: picture.id[i], state: picture.state[i], arc: i * picture.steps * 4 };
  columns.forEach((name, k) => { track[name] = picture.tracks[i * columns.length + k]; });
  return track;
}

export const STATES = ["tentative", "confirmed", "coasting", "static"];
export const LEVELS = ["none", "notice", "caution", "danger"];
export const moves = (track) => track.state !== 3;

// Bearing of a track as the rider sees it [rad], counter-clockwise from straight ahead.
export function bearing(picture, track) {
  const angle = Math.atan2(track.y, track.x) - picture.ego[2];
  return Math.atan2(Math.sin(angle), Math.cos(angle));
}

const SIDES = ["ahead", "ahead left", "left", "behind left", "behind", "behind right", "right", "ahead right"];
export const side = (angle) => SIDES[((Math.round(angle / (Math.PI / 4)) % 8) + 8) % 8];
