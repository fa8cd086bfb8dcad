// Reads a file as Foxglove does, and prints each message as JSON.
import { readFile } from "node:fs/promises";

import { McapIndexedReader } from "@mcap/core";
import { parse } from "@foxglove/rosmsg";
import { MessageReader } from "@foxglove/rosmsg2-serialization";

const content = await readFile(process.argv[2]);
const readable = {
  size: async () => BigInt(content.length),
  read: async (offset, length) => content.subarray(Number(offset), Number(offset + length)),
};
const plain = (_, value) => {
  if (typeof value === "bigint") return Number(value);
  return ArrayBuffer.isView(value) ? Array.from(value) : value;
};

const reader = await McapIndexedReader.Initialize({ readable });
const readers = new Map();
for (const [id, channel] of reader.channelsById) {
  const schema = reader.schemasById.get(channel.schemaId);
  const text = new TextDecoder().decode(schema.data);
  readers.set(id, new MessageReader(parse(text, { ros2: true })));
}
for await (const message of reader.readMessages({ validateCrcs: true })) {
  const { topic } = reader.channelsById.get(message.channelId);
  const value = readers.get(message.channelId).readMessage(message.data);
  console.log(JSON.stringify([topic, message.logTime, value], plain));
}
