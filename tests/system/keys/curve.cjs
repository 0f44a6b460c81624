// Joins a hub by zeromq.js: says one HELLO, prints the answer in hex, or "auth" if the hub does not know the key.
const { Dealer } = require("zeromq");

const [url, publicKey, secretKey, serverKey, hello] = process.argv.slice(2);
const socket = new Dealer({
  curvePublicKey: publicKey,
  curveSecretKey: secretKey,
  curveServerKey: serverKey,
  linger: 0,
});

socket.events.on("handshake:error:auth", () => {
  console.log("auth");
  process.exit(0);
});
socket.connect(url);
socket.send(Buffer.from(hello, "hex"));
socket.receive().then((frames) => {
  console.log(Buffer.concat(frames).toString("hex"));
  process.exit(0);
});
