// The little of msgpack that headers need: nil, booleans, numbers, texts, binaries and arrays.

export function pack(value) {
  return Buffer.from(bytesOf(value));
}

function bytesOf(value) {
  if (value === null) return [0xc0];
  if (typeof value === "boolean") return [value ? 0xc3 : 0xc2];
  if (typeof value === "number" && !Number.isInteger(value)) return [0xcb, ...doubleBytes(value)];
  if (typeof value === "number") return intBytes(value);
  if (typeof value === "bigint") return intBytes(value);
  if (typeof value === "string") {
    const utf8 = Buffer.from(value, "utf8");
    if (utf8.length < 32) return [0xa0 | utf8.length, ...utf8];
    return [0xda, utf8.length >> 8, utf8.length & 0xff, ...utf8];
  }
  if (value instanceof Uint8Array) return [0xc4, value.length, ...value];
  return [0xdc, value.length >> 8, value.length & 0xff, ...value.flatMap(bytesOf)];
}

function doubleBytes(value) {
  const buffer = Buffer.alloc(8);
  buffer.writeDoubleBE(value);
  return buffer;
}

function intBytes(value) {
  if (value >= 0 && value < 128) return [Number(value)];
  const buffer = Buffer.alloc(8);
  buffer.writeBigInt64BE(BigInt(value));
  return [0xd3, ...buffer];
}

export function unpack(buffer) {
  // Integers come back as numbers, or as BigInt where a number would not be exact.
  const view = new DataView(buffer.buffer, buffer.byteOffset, buffer.byteLength);
  let at = 0;

  const skip = (size) => (at += size) - size;
  const uint = (size) => {
    const start = skip(size);
    if (size === 8) return exact(view.getBigUint64(start));
    return size === 4 ? view.getUint32(start) : size === 2 ? view.getUint16(start) : view.getUint8(start);
  };
  const int = (size) => {
    const start = skip(size);
    if (size === 8) return exact(view.getBigInt64(start));
    return size === 4 ? view.getInt32(start) : size === 2 ? view.getInt16(start) : view.getInt8(start);
  };
  const binary = (size) => buffer.subarray(skip(size), at);
  const text = (size) => binary(size).toString("utf8");
  const array = (size) => Array.from({ length: size }, next);

  function next() {
    const tag = view.getUint8(skip(1));
    if (tag < 0x80) return tag;
    if (tag >= 0xe0) return tag - 0x100;
    if (tag >= 0x90 && tag < 0xa0) return array(tag & 0x0f);
    if (tag >= 0xa0 && tag < 0xc0) return text(tag & 0x1f);
    switch (tag) {
      case 0xc0: return null;
      case 0xc2: return false;
      case 0xc3: return true;
      case 0xc4: return binary(uint(1));
      case 0xc5: return binary(uint(2));
      case 0xca: return view.getFloat32(skip(4));
      case 0xcb: return view.getFloat64(skip(8));
      case 0xcc: case 0xcd: case 0xce: case 0xcf: return uint(1 << (tag - 0xcc));
      case 0xd0: case 0xd1: case 0xd2: case 0xd3: return int(1 << (tag - 0xd0));
      case 0xd9: return text(uint(1));
      case 0xda: return text(uint(2));
      case 0xdc: return array(uint(2));
      default: throw new Error(`msgpack tag 0x${tag.toString(16)} has no place in a header`);
    }
  }

  return next();
}

function exact(value) {
  return value >= Number.MIN_SAFE_INTEGER && value <= Number.MAX_SAFE_INTEGER ? Number(value) : value;
}
