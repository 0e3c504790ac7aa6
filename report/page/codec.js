// Decodes the pictures of pictures.py, and computes the displayed value of each code.

const CODES = 32768; // bfloat16 without a sign

/** Codes of an encoded picture: red, green, blue of each pixel, by rows. */
async function unpack(text, width, height) {
  const packed = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  const octets = new Uint8Array(await new Response(stream).arrayBuffer());
  const count = 3 * width * height;
  if (octets.length !== 2 * count) throw new Error(`${octets.length} bytes instead of ${2 * count}`);
  const residuals = new Uint16Array(count);
  for (let i = 0; i < count; i++) residuals[i] = octets[i] | (octets[count + i] << 8);
  return join(restore(residuals, width, height), width * height);
}

/** The planes G, R - G and B - G from the residuals of the prediction. */
function restore(residuals, width, height) {
  const planes = new Int16Array(residuals.length);
  for (let plane = 0, i = 0; plane < 3; plane++) {
    for (let y = 0; y < height; y++) {
      for (let x = 0; x < width; x++, i++) {
        const left = x ? planes[i - 1] : 0;
        const above = y ? planes[i - width] : 0;
        const corner = x && y ? planes[i - width - 1] : 0;
        const low = Math.min(left, above);
        const high = Math.max(left, above);
        const predicted = Math.min(high, Math.max(low, left + above - corner));
        planes[i] = predicted + ((residuals[i] >> 1) ^ -(residuals[i] & 1)); // modulo 2^16
      }
    }
  }
  return planes;
}

function join(planes, pixels) {
  const codes = new Uint16Array(3 * pixels);
  for (let i = 0; i < pixels; i++) {
    const green = planes[i];
    codes[3 * i] = green + planes[pixels + i];
    codes[3 * i + 1] = green;
    codes[3 * i + 2] = green + planes[2 * pixels + i];
  }
  return codes;
}

/** The radiance of each code. */
const radianceOf = new Float32Array(Uint32Array.from({ length: CODES }, (_, code) => code << 16).buffer);

/** The displayed value of each code at an exposure: sRGB from 0 to 1. */
function shownAt(exposure) {
  const shown = new Float32Array(CODES);
  for (let code = 0; code < CODES; code++) {
    const linear = Math.min(1, radianceOf[code] * exposure) || 0;
    shown[code] = linear <= 0.0031308 ? 12.92 * linear : 1.055 * linear ** (1 / 2.4) - 0.055;
  }
  return shown;
}
