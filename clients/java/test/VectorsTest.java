package gluerl;

import java.nio.file.Files;
import java.nio.file.Path;
import java.util.ArrayList;
import java.util.Arrays;
import java.util.HashMap;
import java.util.HexFormat;
import java.util.List;
import java.util.Map;
import java.util.Set;
import java.util.function.Supplier;

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
        Observation runs = new Observation(
                list(map(one).get("ints")).stream().mapToInt(i -> ((Long) i).intValue()).toArray(),
                list(map(one).get("doubles")).stream().mapToDouble(VectorsTest::real).toArray(),
                HEX.parseHex((String) map(one).get("chars")));
        byte[] mask = HEX.parseHex((String) map(one).getOrDefault("mask", ""));
        boolean[] legal = new boolean[8 * mask.length];
        for (int i = 0; i < legal.length; i++) {
            legal[i] = (mask[i / 8] >> i % 8 & 1) == 1;
        }
        byte[] extras = HEX.parseHex((String) map(one).getOrDefault("extras", ""));
        return runs.withMask(legal).withExtras(extras.length == 0 ? Map.of() : Extras.unpack(extras));
    }

    private static Object extra(Object item) {
        Object value = map(item).get("array");
        if (value == null) {
            return scalar(item);
        }
        Object[] items = list(value).stream().map(VectorsTest::scalar).toArray();
        return items.length > 0 && items[0] instanceof Double
                ? Arrays.stream(items).mapToDouble(one -> (Double) one).toArray()
                : Arrays.stream(items).mapToLong(one -> (Long) one).toArray();
    }

    private static void extras(Map<String, Object> entry) {
        byte[] packed = HEX.parseHex((String) entry.get("hex"));
        Map<String, Object> values = map(entry.get("values"));
        Map<String, Object> read = Extras.unpack(packed);
        expect(read.keySet().equals(values.keySet()), entry);
        values.forEach((name, value) -> expect(Arrays.deepEquals(new Object[] {read.get(name)}, new Object[] {extra(value)}), name));
        if (!values.isEmpty()) {
            byte[] ours = Extras.pack(read);
            expect(Arrays.equals(Extras.pack(Extras.unpack(ours)), ours), entry);
        }
    }

    private static void doesNotSend(String why, Supplier<Observation> made) {
        try {
            made.get();
        } catch (IllegalArgumentException error) {
            checked++;
            return;
        }
        throw new AssertionError("accepted: " + why);
    }

    /** What nobody would read, and what is cut off for a hub that does not know it. */
    private static void beside() {
        Observation runs = new Observation(7);
        Map<String, Object> many = new HashMap<>();
        for (int i = 0; i < 65; i++) {
            many.put("n" + i, i);
        }
        doesNotSend("an empty name", () -> runs.withExtras(Map.of("", 1)));
        doesNotSend("a line feed", () -> runs.withExtras(Map.of("a\nb", 1)));
        doesNotSend("a long name", () -> runs.withExtras(Map.of("a".repeat(65), 1)));
        doesNotSend("65 extras", () -> runs.withExtras(many));
        doesNotSend("large extras", () -> runs.withExtras(Map.of("large", new byte[65535])));
        doesNotSend("huge extras", () -> runs.withExtras(Map.of("huge", new double[70000])));
        doesNotSend("a list", () -> runs.withExtras(Map.of("list", List.of(1))));
        doesNotSend("a large mask", () -> runs.withMask(new boolean[8 * 65535 + 1]));

        Observation mask = runs.withMask(false, true, true);
        Observation extras = runs.withExtras(Map.of("coins", 3));
        byte[] all = mask.withExtras(Map.of("coins", 3)).body();
        expect(Observation.cut(all, true, true) == all, "all");
        expect(Arrays.equals(Observation.cut(all, true, false), mask.body()), "mask");
        expect(Arrays.equals(Observation.cut(all, false, true), extras.body()), "extras");
        expect(Arrays.equals(Observation.cut(all, false, false), runs.body()), "neither");
        expect(mask.legal(1) && !mask.legal(0) && !mask.legal(3) && !mask.legal(8) && runs.legal(9), "legal");
        Observation last = runs.withMask(false, false, false, false, false, false, false, true);
        expect(!last.legal(-1) && !last.legal(-9), "values below the first");
        expect(extras.extras().equals(Map.of("coins", 3L)), "coins");
    }

    /** -2^63 is its own absolute value. */
    private static void reals() {
        expect(new Unpacker(HEX.parseHex("d3ffe0000000000000"), "it").real() == -0x1p53, "-2^53");
        try {
            new Unpacker(HEX.parseHex("d38000000000000000"), "it").real();
        } catch (GlueException.Protocol error) {
            checked++;
            return;
        }
        throw new AssertionError("accepted: -2^63 as a float");
    }

    private static void masks() {
        Observation runs = new Observation(7);
        Masks masks = new Masks(
                "OBSERVATIONS INTS (0 9) Actions DOUBLES (0 1) ints (0 1)( 2 -1 1 ) CHARCOUNT 2 REWARDS (0 1) EXTRA INTS (0 1)");
        masks.checked("step", runs);
        masks.checked("step", runs.withMask(false, true, false, false, true, true, false, false));
        doesNotSend("an empty int", () -> masks.checked("step", runs.withMask(false, true, false, false, false, true, true, false)));
        doesNotSend("a long mask", () -> masks.checked("step", runs.withMask(true, true, true, true, true, true, true, true, true)));
        doesNotSend("a short mask", () -> masks.checked("step", runs.withMask(true, true, true, true, true, true, true)));
        doesNotSend("one value more", () -> new Masks("ACTIONS INTS (0 1) (0 1) REWARDS")
                .checked("step", runs.withMask(true, false, true, false, true)));
        doesNotSend("a mask for 20000 ints", () -> new Masks("ACTIONS INTS" + " (0 1)".repeat(20_000) + " REWARDS")
                .checked("step", runs.withMask(true)));
        for (String unknown : new String[] {"ACTIONS INTS (0 UNSPEC) REWARDS", "a mirror", "ACTIONS REWARDS EXTRA INTS (0 1)"}) {
            new Masks(unknown).checked("step", runs.withMask(false));
        }
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
            expect(Arrays.deepEquals(new Object[] {message.scalars()[i]}, new Object[] {expected}), entry);
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
        for (String section : new String[] {"messages", "accepted", "truncate", "beside", "pace"}) {
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
        Map<String, Object> extras = map(vectors.get("extras"));
        list(extras.get("accepted")).forEach(one -> extras(map(one)));
        for (Object one : list(extras.get("refused"))) {
            refuses(one.toString(), () -> Extras.unpack(HEX.parseHex((String) map(one).get("hex"))));
        }
        beside();
        masks();
        reals();
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
