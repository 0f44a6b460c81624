package gluerl;

import java.util.Arrays;
import java.util.Locale;
import java.util.regex.Matcher;
import java.util.regex.Pattern;
import java.util.stream.IntStream;

/** The masks that a task spec has room for. */
final class Masks {
    /** Possessive, so that a long list of ranges is matched without recursion. */
    private static final Pattern INTS =
            Pattern.compile("ACTIONS(?:(?!REWARDS).)*?INTS\\s*((?:\\([^)]*\\)\\s*)*+)", Pattern.DOTALL);
    private static final Pattern RANGE =
            Pattern.compile("\\(\\s*(?:(\\d{1,6})\\s+)?(-?\\d{1,10})\\s+(-?\\d{1,10})\\s*\\)\\s*");

    private final long[] sizes;

    /** Takes the number of values of each int of an action, if the task spec says all in whole numbers. */
    Masks(String taskSpec) {
        Matcher ints = INTS.matcher(taskSpec.toUpperCase(Locale.ROOT));
        String ranges = ints.find() ? ints.group(1) : "";
        Matcher range = RANGE.matcher(ranges);
        long[] found = {};
        int end = 0;
        while (range.find() && range.start() == end && found.length <= 8 * Observation.MAX_BESIDE) {
            end = range.end();
            int before = found.length;
            found = Arrays.copyOf(found, before + (range.group(1) == null ? 1 : Integer.parseInt(range.group(1))));
            Arrays.fill(found, before, found.length, Long.parseLong(range.group(3)) - Long.parseLong(range.group(2)) + 1);
        }
        boolean known = end == ranges.length() && Arrays.stream(found).allMatch(size -> size > 0);
        sizes = known ? found : new long[0];
    }

    /** Returns an observation; throws an exception if its mask does not fit, or leaves an int no legal value. */
    Observation checked(String method, Observation observation) {
        int given = observation.maskValues();
        if (given == 0 || sizes.length == 0) {
            return observation;
        }
        long values = Arrays.stream(sizes).sum();
        boolean more = IntStream.range((int) Math.min(values, given), given).anyMatch(observation::legal);
        if (given < values || given > (values + 7) / 8 * 8 || more) {
            throw unfit(method, "it is of " + given + " values, and the ints of an action have " + values);
        }
        int at = 0;
        for (int i = 0; i < sizes.length; i++) {
            int end = at + (int) sizes[i];
            if (IntStream.range(at, end).noneMatch(observation::legal)) {
                throw unfit(method, "no value of int " + i + " is legal");
            }
            at = end;
        }
        return observation;
    }

    private static IllegalArgumentException unfit(String method, String why) {
        return new IllegalArgumentException(
                method + " returned an observation whose mask does not fit the task spec: " + why);
    }
}
