package gluerl;

import java.nio.file.Files;
import java.nio.file.Path;
import java.util.ArrayList;
import java.util.Arrays;
import java.util.HexFormat;
import java.util.List;
import java.util.Map;
import java.util.Set;

/** The codec against glue/testing/vectors.json, which docs/clients.md describes. */
final class VectorsTest {
    private static final HexFormat HEX = HexFormat.of();
    private static final Set<String> ROLES = Set.of("peer", "agent", "environment", "experiment");

    private static int checked;

    @SuppressWarnings("unchecked")
    private static Map<String, Object> map(Object value) {
        return (Map<String, Object>) value;
    }

    @SuppressWarnings("unchecked")
    private static List<Object> list(Object value) {
        return (List<Object>) value;
    }

    private static double real(Object hex) {
        return Double.longBitsToDouble(HexFormat.fromHexDigitsToLong((String) hex));
    }

    private static byte[][] frames(Object hex) {
        return list(hex).stream().map(one -> HEX.parseHex((String) one)).toArray(byte[][]::new);
    }

    private static Object scalar(Object item) {
        Map.Entry<String, Object> entry = map(item).entrySet().iterator().next();
        Object value = entry.getValue();
        return switch (entry.getKey()) {
            case "int" -> Long.parseLong((String) value);
            case "float" -> real(value);
            case "binary" -> HEX.parseHex((String) value);
            case "nil" -> null;
            case "array" -> {
                Object[] items = list(value).stream().map(VectorsTest::scalar).toArray();
                yield items.length > 0 && items[0] instanceof Long
                        ? Arrays.stream(items).mapToLong(one -> (Long) one).toArray()
                        : Arrays.copyOf(items, items.length, String[].class);
            }
            default -> value;
        };
    }

    private static Observation abstractType(Object one) {
        return new Observation(
                list(map(one).get("ints")).stream().mapToInt(i -> ((Long) i).intValue()).toArray(),
                list(map(one).get("doubles")).stream().mapToDouble(VectorsTest::real).toArray(),
                HEX.parseHex((String) map(one).get("chars")));
    }

    private static byte[] body(Object body) {
        if (body == null) {
            return null;
        }
        if (map(body).containsKey("text")) {
            return Message.utf8((String) map(body).get("text"));
        }
        if (map(body).containsKey("bytes")) {
            return HEX.parseHex((String) map(body).get("bytes"));
        }
        return abstractType(list(map(body).get("abstract")).get(0)).body();
    }

    private static void expect(boolean right, Object what) {
        checked++;
        if (!right) {
            throw new AssertionError(what);
        }
    }

    private static void decodes(Map<String, Object> entry) {
        Message message = Message.decode(frames(entry.get("frames")));
        expect(message.code() == (Long) entry.get("code"), entry);
        expect(message.session().equals(entry.get("session")), entry);
        expect(message.seq() == Long.parseLong((String) entry.get("seq")), entry);
        Object[] scalars = list(entry.get("scalars")).stream().map(VectorsTest::scalar).toArray();
        for (int i = 0; i < scalars.length; i++) {
            Object expected = message.scalars()[i] instanceof Boolean && scalars[i] instanceof Long number
                    ? (Object) (number != 0) : scalars[i];
            expect(message.scalars()[i].equals(expected), entry);
        }
        Object body = entry.get("body");
        if (body != null && map(body).containsKey("abstract")) {
            var reader = message.reader();
            for (Object one : list(map(body).get("abstract"))) {
                expect(new Observation(reader).equals(abstractType(one)), entry);
            }
        } else {
            expect(Arrays.equals(message.body(), body(body)), entry);
        }
    }

    private static void encodes(Map<String, Object> entry) {
        Kind kind = Kind.valueOf((String) entry.get("kind"));
        byte[][] encoded = Message.encode(
                kind,
                (String) entry.get("session"),
                Long.parseLong((String) entry.get("seq")),
                body(entry.get("body")),
                list(entry.get("scalars")).stream().map(VectorsTest::scalar).toArray());
        expect(Arrays.deepEquals(encoded, frames(entry.get("frames"))), entry);
        expect(HEX.formatHex(FrameReader.frames(0, encoded)).equals(entry.get("wire")), entry);
    }

    /** Returns the items that come of bytes behind a greeting, which are received one at a time. */
    private static List<FrameReader.Item> read(String hex) {
        FrameReader reader = new FrameReader();
        List<FrameReader.Item> items = new ArrayList<>();
        for (byte one : HEX.parseHex(HEX.formatHex(FrameReader.greeting()) + hex)) {
            reader.room().put(one);
            reader.received(1);
            for (FrameReader.Item item; (item = reader.next()) != null; ) {
                items.add(item);
            }
        }
        return items.subList(1, items.size());
    }

    private static void refuses(String name, Runnable action) {
        try {
            action.run();
        } catch (GlueException.Protocol error) {
            checked++;
            return;
        }
        throw new AssertionError("not refused: " + name);
    }

    public static void main(String[] args) throws Exception {
        Map<String, Object> vectors = map(Json.parse(Files.readString(Path.of(args[0]))));
        for (String section : new String[] {"messages", "accepted", "truncate"}) {
            for (Object one : list(vectors.get(section))) {
                Map<String, Object> entry = map(one);
                if (!ROLES.contains(entry.get("from")) && !ROLES.contains(entry.get("to"))) {
                    continue; // this library has no such role
                }
                if (entry.get("from").equals("hub")) {
                    decodes(entry);
                    var frames = ((FrameReader.Frames) read((String) entry.get("wire")).get(0)).frames();
                    expect(Arrays.deepEquals(frames, frames(entry.get("frames"))), entry);
                } else {
                    encodes(entry);
                }
            }
        }
        for (Object one : list(vectors.get("refused"))) {
            String wire = (String) map(one).get("wire");
            refuses(one.toString(), () -> Message.decode(((FrameReader.Frames) read(wire).get(0)).frames()));
        }
        Map<String, Object> zmtp = map(vectors.get("zmtp"));
        expect(HEX.formatHex(FrameReader.greeting()).equals(zmtp.get("greeting")), "greeting");
        expect(HEX.formatHex(FrameReader.ready()).equals(zmtp.get("ready")), "ready");
        FrameReader.Command ping = (FrameReader.Command) read((String) zmtp.get("ping with a context")).get(0);
        expect(ping.name().equals("PING"), ping);
        for (Object one : list(zmtp.get("refused"))) {
            if (!map(one).get("name").toString().contains("ERROR")) {
                refuses(one.toString(), () -> read((String) map(one).get("hex")));
            }
        }
        System.out.println(checked + " checks passed");
    }
}
