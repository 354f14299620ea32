// Reads an MCAP file with the packages that Foxglove is made of; prints topic, log time and what was decoded, as JSON.
const fs = require("fs");
const { McapIndexedReader } = require("@mcap/core");
const { parse } = require("@foxglove/rosmsg");
const { MessageReader } = require("@foxglove/rosmsg2-serialization");

async function main(path) {
  const file = fs.readFileSync(path);
  const readable = {
    size: async () => BigInt(file.length),
    read: async (offset, size) => new Uint8Array(file.subarray(Number(offset), Number(offset + size))),
  };
  const log = await McapIndexedReader.Initialize({ readable });
  const readers = new Map();
  const found = [];
  for await (const message of log.readMessages()) {
    const channel = log.channelsById.get(message.channelId);
    const schema = log.schemasById.get(channel.schemaId);
    if (!readers.has(schema.name)) {
      const definitions = parse(new TextDecoder().decode(schema.data), { ros2: true });
      readers.set(schema.name, new MessageReader(definitions));
    }
    const decoded = readers.get(schema.name).readMessage(message.data);
    found.push({
      topic: channel.topic,
      stamp: message.logTime.toString(),
      horizon: decoded.horizon ? decoded.horizon.nanosec ?? decoded.horizon.nsec : null,
      indices: decoded.indices ? Array.from(decoded.indices) : null,
      text: decoded.data ?? null,
    });
  }
  console.log(JSON.stringify({ profile: log.header.profile, messages: found }));
}

main(process.argv[2]);
