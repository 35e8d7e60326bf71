"use strict";
// Images of the page: linear RGB, stored as half floats in base64.
const pixels = (() => {
  const halves = Float32Array.from({length: 65536}, (_, h) => {
    const sign = h & 0x8000 ? -1 : 1, e = h >> 10 & 31, m = h & 1023;
    if (e === 31) return m ? NaN : sign * Infinity;
    return sign * (e === 0 ? m * 2 ** -24 : (1024 + m) * 2 ** (e - 25));
  });
  const decode = text => {
    const bytes = Uint8Array.from(atob(text), c => c.charCodeAt(0)), rgb = new Float32Array(bytes.length / 2);
    for (let i = 0; i < rgb.length; ++i) rgb[i] = halves[bytes[2 * i] | bytes[2 * i + 1] << 8];
    return rgb;
  };
  const luminance = (rgb, i) => 0.212671 * rgb[3 * i] + 0.71516 * rgb[3 * i + 1] + 0.072169 * rgb[3 * i + 2];
  const srgb = new Uint8ClampedArray(4097);  // of [0, 1] in steps of 1/4096
  for (let i = 0; i < srgb.length; ++i) {
    const v = i / 4096;
    srgb[i] = Math.round(255 * (v <= 0.0031308 ? 12.92 * v : 1.055 * v ** (1 / 2.4) - 0.055));
  }
  const byteOf = value => srgb[Math.min(4096, Math.max(0, Math.round(4096 * value)))] || 0;
  return {decode, luminance, srgb, byteOf};
})();
