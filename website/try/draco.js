/* Google's JavaScript build of Draco as the package DracoPy: the same calls in the same order. */

const FOLDER = 'npm/draco3dgltf@1.5.7/';
const COPIED = { 2: ['DT_UINT8', Uint8Array], 4: ['DT_UINT16', Uint16Array], 6: ['DT_UINT32', Uint32Array] };
const ADDED = {
  Uint8Array: 'AddUInt8Attribute', Uint16Array: 'AddUInt16Attribute', Uint32Array: 'AddUInt32Attribute',
  Int8Array: 'AddInt8Attribute', Int16Array: 'AddInt16Attribute', Int32Array: 'AddInt32Attribute', Float32Array: 'AddFloatAttribute',
};

export async function dracoCodec(imported, bytesOf) {
  const [decoders, encoders] = await Promise.all([
    imported(`${FOLDER}draco_decoder_gltf_nodejs.js`, 'DracoDecoderModule'),
    imported(`${FOLDER}draco_encoder_gltf_nodejs.js`, 'DracoEncoderModule'),
  ]);
  const d = await decoders.default({ wasmBinary: await bytesOf(`${FOLDER}draco_decoder_gltf.wasm`) });
  const e = await encoders.default({ wasmBinary: await bytesOf(`${FOLDER}draco_encoder.wasm`) });

  function read(length, Kind, fill) {
    const size = length * Kind.BYTES_PER_ELEMENT, at = d._malloc(size);
    fill(size, at);
    const found = new Kind(d.HEAPU8.slice(at, at + size).buffer);
    d._free(at);
    return found;
  }

  function decode(bytes) {
    const decoder = new d.Decoder(), mesh = new d.Mesh();
    const status = decoder.DecodeArrayToMesh(bytes, bytes.length, mesh);
    if (!status.ok()) throw new Error(status.error_msg());
    const faces = read(3 * mesh.num_faces(), Uint32Array, (size, at) => decoder.GetTrianglesUInt32Array(mesh, size, at));
    const attributes = Array.from({ length: mesh.num_attributes() }, (_, number) => {
      const attribute = decoder.GetAttribute(mesh, number), width = attribute.num_components();
      const [type, Kind] = COPIED[attribute.data_type()] ?? ['DT_FLOAT32', Float32Array];
      const data = read(width * mesh.num_points(), Kind, (size, at) => decoder.GetAttributeDataArrayForAllPoints(mesh, attribute, d[type], size, at));
      return { unique_id: attribute.unique_id(), attribute_type: attribute.attribute_type(), data_type: attribute.data_type(), width, data };
    });
    d.destroy(mesh);
    d.destroy(decoder);
    return { faces, attributes };
  }

  /* attributes: type, width, data and quantisation of each, in the order of their unique ids. */
  function encode(faces, attributes, level) {
    const encoder = new e.Encoder(), builder = new e.MeshBuilder(), mesh = new e.Mesh();
    builder.AddFacesToMesh(mesh, faces.length / 3, faces);
    for (const { type, width, data, bits, origin, range } of attributes) {
      builder[ADDED[data.constructor.name]](mesh, e[type], data.length / width, width, data);
      if (range > 0) encoder.SetAttributeExplicitQuantization(e[type], bits, width, origin, range);
      else if (bits > 0) encoder.SetAttributeQuantization(e[type], bits);
    }
    encoder.SetEncodingMethod(e.MESH_SEQUENTIAL_ENCODING);
    encoder.SetSpeedOptions(10 - level, 10 - level);
    const buffer = new e.DracoInt8Array(), size = encoder.EncodeMeshToDracoBuffer(mesh, buffer);
    if (size === 0) throw new Error('the encoder failed');
    const found = Uint8Array.from({ length: size }, (_, at) => buffer.GetValue(at));
    for (const one of [buffer, mesh, builder, encoder]) e.destroy(one);
    return found;
  }

  return { decode, encode };
}
