package gluerl;

import java.io.IOException;
import java.net.InetSocketAddress;
import java.net.SocketAddress;
import java.net.StandardProtocolFamily;
import java.net.StandardSocketOptions;
import java.net.UnixDomainSocketAddress;
import java.nio.ByteBuffer;
import java.nio.channels.SelectionKey;
import java.nio.channels.Selector;
import java.nio.channels.SocketChannel;
import java.nio.charset.StandardCharsets;
import java.util.Arrays;
import java.util.function.Consumer;
import java.util.regex.Matcher;
import java.util.regex.Pattern;

/** A ZeroMQ DEALER over tcp or a Unix socket: one connection after another to the same address. */
final class Dealer {
    private static final Pattern TCP = Pattern.compile("tcp://(\\[[^\\]]+\\]|[^:/]+):(\\d{1,5})");
    private static final String IPC = "ipc://";
    private static final int MAX_PATH = 107;
    private static final long RECONNECT_MS = 100;
    private static final int CONNECT_MS = 5000;
    private static final long LINGER_MS = 1000;

    private final SocketAddress address;
    private final String hub;
    private final Consumer<String> log;
    private final Selector selector;
    private SocketChannel channel;
    private FrameReader reader = new FrameReader();
    private boolean ready;
    private int connections;
    private long silent; // milliseconds waited since anything was received
    private long attempted = System.nanoTime() - RECONNECT_MS * 1_000_000; // when a connection was tried last

    Dealer(String hub, Consumer<String> log) {
        this.hub = hub;
        this.log = log;
        address = addressOf(hub);
        try {
            selector = Selector.open();
        } catch (IOException error) {
            throw new GlueException.Config("no selector can be opened: " + error.getMessage());
        }
    }

    /** Returns how many connections there were, this one included. */
    int connections() {
        return connections;
    }

    /** Returns whether there is a connection that can carry messages. */
    boolean isReady() {
        return ready;
    }

    /**
     * Returns the frames of the next message; null if there is none within this time, or a new connection.
     *
     * @param millis the time
     * @param timeout milliseconds of silence after which a connection is given up
     */
    byte[][] receive(long millis, long timeout) {
        try {
            if (channel == null && !connect()) {
                return null;
            }
            while (true) {
                FrameReader.Item item;
                while ((item = reader.next()) != null) {
                    if (item instanceof FrameReader.Frames message) {
                        return message.frames();
                    }
                    if (take(item)) {
                        return null;
                    }
                }
                if (selector.select(millis) == 0) {
                    if (Thread.currentThread().isInterrupted()) {
                        throw new GlueException.HubClosed("this thread was interrupted");
                    }
                    silent += millis;
                    if (silent >= timeout) {
                        drop();
                    }
                    return null;
                }
                selector.selectedKeys().clear();
                int count = channel.read(reader.room());
                if (count < 0) {
                    drop();
                    return null;
                }
                silent = 0;
                reader.received(count);
            }
        } catch (IOException error) {
            drop();
            return null;
        }
    }

    /** Sends a message. Without a connection it is lost, as when one breaks: the hub asks again. */
    void send(byte[][] frames) {
        if (ready) {
            write(FrameReader.frames(0, frames));
        }
    }

    /** Closes when what was sent has left. */
    void close() {
        try (selector) {
            if (ready) {
                channel.shutdownOutput();
                ByteBuffer rest = ByteBuffer.allocate(4096);
                long deadline = System.nanoTime() + LINGER_MS * 1_000_000;
                long left = LINGER_MS;
                while (left > 0 && selector.select(left) > 0) {
                    selector.selectedKeys().clear();
                    if (channel.read(rest.clear()) < 0) {
                        break;
                    }
                    left = (deadline - System.nanoTime()) / 1_000_000;
                }
            }
        } catch (IOException error) {
            // It is closed all the same.
        } finally {
            drop();
        }
    }

    private boolean connect() throws IOException {
        pause(RECONNECT_MS - (System.nanoTime() - attempted) / 1_000_000);
        attempted = System.nanoTime();
        boolean tcp = address instanceof InetSocketAddress;
        SocketChannel made = tcp ? SocketChannel.open() : SocketChannel.open(StandardProtocolFamily.UNIX);
        try {
            if (tcp) {
                made.socket().connect(address, CONNECT_MS);
                made.setOption(StandardSocketOptions.TCP_NODELAY, true);
            } else {
                made.connect(address);
            }
        } catch (IOException error) {
            made.close();
            return false;
        }
        made.configureBlocking(false);
        made.register(selector, SelectionKey.OP_READ);
        channel = made;
        reader = new FrameReader();
        silent = 0;
        write(FrameReader.greeting());
        return channel != null;
    }

    /** Acts on what is no message; returns whether there is a new connection, or none any more. */
    private boolean take(FrameReader.Item item) {
        if (item instanceof FrameReader.Greeting) {
            write(FrameReader.ready());
        } else if (item instanceof FrameReader.Command command) {
            byte[] data = command.data();
            switch (command.name()) {
                case "READY" -> {
                    ready = true;
                    connections += 1;
                    return true;
                }
                case "PING" -> write(pong(data));
                case "ERROR" -> {
                    int from = Math.min(1, data.length);
                    String reason = new String(data, from, data.length - from, StandardCharsets.UTF_8);
                    log.accept("the hub at %s ends the connection: %s".formatted(hub, reason));
                    drop();
                }
                default -> { }
            }
        }
        return channel == null;
    }

    private static byte[] pong(byte[] ping) {
        byte[] name = "\4PONG".getBytes(StandardCharsets.US_ASCII);
        int context = Math.max(0, ping.length - 2); // after two bytes of time to live
        byte[] pong = Arrays.copyOf(name, name.length + context);
        System.arraycopy(ping, ping.length - context, pong, name.length, context);
        return FrameReader.frames(FrameReader.COMMAND, pong);
    }

    private void write(byte[] bytes) {
        ByteBuffer left = ByteBuffer.wrap(bytes);
        try {
            channel.write(left);
            if (left.hasRemaining()) {
                writeSlowly(left);
            }
        } catch (IOException error) {
            drop();
        }
    }

    /** Writes what the operating system has no room for yet. */
    private void writeSlowly(ByteBuffer left) throws IOException {
        try (Selector room = Selector.open()) {
            channel.register(room, SelectionKey.OP_WRITE);
            while (left.hasRemaining()) {
                if (room.select(CONNECT_MS) == 0) {
                    throw new IOException("the hub reads nothing");
                }
                room.selectedKeys().clear();
                channel.write(left);
            }
        }
    }

    private void drop() {
        ready = false;
        if (channel != null) {
            try {
                channel.close();
                // A closed channel stays registered until the next selection.
                if (selector.isOpen()) {
                    selector.selectNow();
                }
            } catch (IOException error) {
                // It is of no more use, closed or not.
            }
            channel = null;
        }
    }

    private static void pause(long millis) {
        try {
            Thread.sleep(Math.max(0, millis));
        } catch (InterruptedException error) {
            Thread.currentThread().interrupt();
            throw new GlueException.HubClosed("this thread was interrupted");
        }
    }

    private static SocketAddress addressOf(String hub) {
        if (hub.startsWith(IPC) && hub.length() > IPC.length()) {
            String path = hub.substring(IPC.length());
            int size = Message.utf8(path).length;
            if (size > MAX_PATH) {
                throw new GlueException.Config("the path of a Unix socket has at most %d bytes, and %s has %d"
                        .formatted(MAX_PATH, path, size));
            }
            return UnixDomainSocketAddress.of(path);
        }
        Matcher tcp = TCP.matcher(hub);
        if (!tcp.matches() || Integer.parseInt(tcp.group(2)) < 1 || Integer.parseInt(tcp.group(2)) > 65535) {
            throw new GlueException.Config(
                    "the address of a hub is like tcp://127.0.0.1:4097 or ipc:///tmp/hub, not \"%s\"".formatted(hub));
        }
        InetSocketAddress resolved = new InetSocketAddress(tcp.group(1), Integer.parseInt(tcp.group(2)));
        if (resolved.isUnresolved()) {
            throw new GlueException.Config("the host %s is unknown".formatted(tcp.group(1)));
        }
        return resolved;
    }
}
